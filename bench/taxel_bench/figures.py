"""Figures for people: three significant digits, no exponents; tables in Markdown."""

from collections.abc import Sequence
from math import floor, log10


def short(value: float) -> str:
    """A positive value to three significant digits, such as 0.0421, 9.35 or 1,234."""
    if value <= 0:
        return "0"
    return f"{value:,.{max(0, 2 - floor(log10(value)))}f}"


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table: the first column to the left, all others to the right."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return ["| " + " | ".join(cells) + " |" for cells in lines]

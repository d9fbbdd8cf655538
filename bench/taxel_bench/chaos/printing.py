"""Bars for the terminal, and their verdict."""

from collections.abc import Sequence

from rich.table import Table

from taxel_bench.chaos.bars import Bar


def verdict_of_bars(bars: Sequence[Bar]) -> str:
    """`VALID` where each figure is within its limit."""
    return "VALID" if all(bar.holds for bar in bars) else "INVALID"


def bars_table(bars: Sequence[Bar]) -> Table:
    """A row for each figure."""
    table = Table("figure", "measured", "must be", "verdict")
    for bar in bars:
        table.add_row(bar.what, f"{bar.figure:.3g}", bar.wanted, bar.verdict)
    return table

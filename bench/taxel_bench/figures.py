"""Figures for people: three significant digits, no exponents."""

from math import floor, log10


def short(value: float) -> str:
    """A positive value to three significant digits, such as 0.0421, 9.35 or 1,234."""
    if value <= 0:
        return "0"
    return f"{value:,.{max(0, 2 - floor(log10(value)))}f}"

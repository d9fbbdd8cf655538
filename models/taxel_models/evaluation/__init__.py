"""Predictions against measurements: errors, tables, plots and files."""

from typing import Final

FIGURES: Final = "errors.json"
"""A report's raw figures; a folder that holds them is a report."""

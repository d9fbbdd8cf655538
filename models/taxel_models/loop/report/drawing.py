"""What the pictures of a report have in common: their colours, and what is drawn."""

from typing import Final

from matplotlib.figure import Figure

Drawing = tuple[Figure, str]
"""A figure with its caption."""

BEFORE: Final = "#d1495b"
AFTER: Final = "#30638e"
NOISE: Final = "#8a8f98"
MEASURED: Final = "#444444"
STRUCTURE: Final = "#edae49"

"""The colours that all pictures of a report share."""

from typing import Final

BEFORE: Final = "#d1495b"
AFTER: Final = "#30638e"
NOISE: Final = "#8a8f98"
MEASURED: Final = "#444444"
STRUCTURE: Final = "#edae49"

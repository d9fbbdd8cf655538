"""Counts less rest as colours: one diverging scale, orange below rest and blue above.

The two hues stay apart for colour-blind eyes. The scale takes the signed square root, so that 30 counts
can be seen beside 1,000.
"""

from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

LIMIT: Final = 1000
"""The ends of the scale, counts less rest. Further values have the colour of the ends."""

Theme = Literal["light", "dark"]

STOPS: Final[dict[Theme, dict[str, list[list[int]]]]] = {
    "light": {
        "below": [[247, 247, 244], [253, 205, 140], [236, 133, 35], [166, 69, 0], [96, 36, 0]],
        "above": [[247, 247, 244], [167, 211, 240], [66, 150, 211], [9, 88, 155], [3, 45, 92]],
    },
    "dark": {
        "below": [[44, 49, 56], [112, 67, 26], [196, 104, 22], [255, 153, 51], [255, 219, 150]],
        "above": [[44, 49, 56], [24, 75, 117], [33, 117, 184], [80, 170, 242], [190, 226, 255]],
    },
}
"""Red, green and blue at equal steps from rest to an end of the scale."""


def colours_of(values: NDArray[np.float64], theme: Theme) -> NDArray[np.int64]:
    """Red, green and blue (n, 3) of counts less rest (n,)."""
    shares = np.sqrt(np.minimum(np.abs(values), LIMIT) / LIMIT)
    steps = np.linspace(0.0, 1.0, len(STOPS[theme]["below"]))
    sides = [
        np.column_stack([np.interp(shares, steps, part) for part in np.array(STOPS[theme][side]).T])
        for side in ("below", "above")
    ]
    return np.rint(np.where(values[:, None] < 0.0, *sides)).astype(np.int64)

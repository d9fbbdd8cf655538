"""Electrode glitches: samples that jump far away and back."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

GLITCH_COUNTS: Final = 1000
"""An electrode above this, between neighbours in time that are near 0, is a glitch."""

NEAR_ZERO_COUNTS: Final = 500
"""What counts as near 0; otherwise the electrodes of this data set stay below 240."""

GLITCH_ROWS: Final = 3
"""A glitch lasts at most this many rows. A longer one is a signal."""


def glitches(electrodes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Rows in which an electrode jumps from near 0 above `GLITCH_COUNTS` and back.

    For each electrode: a run of at most `GLITCH_ROWS` rows above `GLITCH_COUNTS`, with a row below
    `NEAR_ZERO_COUNTS` on each side. At an end of the trial, the side that exists decides.

    Args:
        electrodes: (n, e), counts, the rows of one trial.

    Returns:
        (n,) bool.
    """
    rows = len(electrodes)
    found = np.zeros(electrodes.shape, bool)
    high = electrodes > GLITCH_COUNTS
    near_zero = np.pad(electrodes < NEAR_ZERO_COUNTS, ((1, 1), (0, 0)), constant_values=True)
    for length in range(1, min(GLITCH_ROWS, rows - 1) + 1):
        starts = rows - length + 1
        run = near_zero[:starts] & near_zero[length + 1 :]
        for offset in range(length):
            run &= high[offset : offset + starts]
        for offset in range(length):
            found[offset : offset + starts] |= run
    return np.asarray(found.any(axis=1))

"""Glitches: samples that jump far away and back."""

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


JUMP_COUNTS: Final = 200
"""A shorter jump may be a tap."""

_USUAL_STEPS: Final = 10
"""A jump is so many times longer than all but one in a thousand steps from row to row."""

_RARE: Final = 0.01
"""Where fewer rows than this share jump, these jumps are none of the usual steps: else a few glitches
would hide each other in a short recording."""


def jumps(channels: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Glitches in any format: values that jump far from the rows on both sides, to the same side of them.

    For each channel: a run of at most `GLITCH_ROWS` rows that lie above, or below, the row before and the
    row after it, by more than `JUMP_COUNTS` and more than the channel is used to.

    Args:
        channels: (n, c), counts, the rows of one segment.

    Returns:
        (n, c) bool.
    """
    if len(channels) < 3:
        return np.zeros(channels.shape, bool)
    found = _excursions(channels, np.full(channels.shape[1], JUMP_COUNTS))
    if not found.any():
        return found
    steps = np.abs(np.diff(channels, axis=0))
    steps[(found[1:] | found[:-1]) & (found.mean(axis=0) <= _RARE)] = np.nan
    usual = np.nanquantile(steps, 0.999, axis=0)
    return _excursions(channels, np.maximum(JUMP_COUNTS, _USUAL_STEPS * usual))


def _excursions(channels: NDArray[np.float64], far: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Runs of at most `GLITCH_ROWS` rows that lie further than `far`, (c,), beyond the rows around them."""
    found = np.zeros(channels.shape, bool)
    for length in range(1, min(GLITCH_ROWS, len(channels) - 2) + 1):
        starts = len(channels) - length - 1
        before, after = channels[:starts], channels[length + 1 :]
        above, below = np.ones((2, *before.shape), bool)
        for offset in range(1, length + 1):
            inside = channels[offset : offset + starts]
            above &= inside - np.maximum(before, after) > far
            below &= np.minimum(before, after) - inside > far
        for offset in range(1, length + 1):
            found[offset : offset + starts] |= above | below
    return found

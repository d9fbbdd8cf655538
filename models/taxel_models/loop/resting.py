"""Resting counts: what a channel reads without contact."""

from typing import Final

import numpy as np

from taxel.channels import ELECTRODE_COLUMNS
from taxel.windows.history import TOUCH_N
from taxel_models.loop.basis import Floats

_REST_ROWS: Final = 50

_RAW_COUNTS: Final = 500.0
"""Electrodes of a finger at rest read 2300 to 3500."""


def resting(pressed: Floats, counts: Floats) -> Floats:
    """(21,) the median of counts (n, 21) in free air.

    Without rows in free air, tared channels rest at 0; for others, the rows with the least force (n,), N,
    are used.
    """
    free = pressed < TOUCH_N
    if free.sum() >= _REST_ROWS:
        return np.asarray(np.median(counts[free], axis=0))
    least = np.median(counts[pressed <= np.quantile(pressed, 0.02)], axis=0)
    return np.asarray(least if are_raw(least) else np.zeros_like(least))


def are_raw(rest: Floats) -> bool:
    """Whether resting counts (21,) are the converter's, and not differences from such."""
    return bool(np.median(rest[ELECTRODE_COLUMNS]) > _RAW_COUNTS)

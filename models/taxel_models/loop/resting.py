"""Resting counts: what a channel reads without contact."""

from typing import Final

import numpy as np

from taxel.channels import ELECTRODE_COLUMNS
from taxel.errors import RecordingError
from taxel.windows.history import TOUCH_N
from taxel_models.loop.basis import Floats

_REST_ROWS: Final = 50

_RAW_COUNTS: Final = 500.0
"""Electrodes of a finger at rest read 2300 to 3500."""

_SURELY_RAW: Final = 3 * _RAW_COUNTS
"""Far from both: a rest near the limit between raw and tared counts is no proof of either."""


def resting(pressed: Floats, counts: Floats) -> Floats:
    """(21,) the median of counts (n, 21) in free air.

    Without rows in free air, tared channels rest at 0; for others, the rows with the least force (n,), N,
    are used.
    """
    free = pressed < TOUCH_N
    least = _least_pressed(pressed, counts)
    return least if free.sum() >= _REST_ROWS or are_raw(least) else np.zeros_like(least)


def _least_pressed(pressed: Floats, counts: Floats) -> Floats:
    """(21,) the median of counts (n, 21) in free air, or else at the least force."""
    free = pressed < TOUCH_N
    if free.sum() < _REST_ROWS:
        free = pressed <= np.quantile(pressed, 0.02)
    return np.asarray(np.median(counts[free], axis=0))


def check_scale(model: str, pressed: Floats, predicted: Floats, measured: Floats) -> None:
    """Check that a model and recordings both have the converter's counts, or both differences from rest.

    Args:
        model: its name.
        pressed: (n,) the force's magnitude, N.
        predicted: (n, 21) counts.
        measured: (n, 21) counts.

    Raises:
        RecordingError: one of the two has been tared. Electrodes that all read one value are no such case.
    """
    electrodes = measured[:, ELECTRODE_COLUMNS]
    own, other = (
        float(np.median(_least_pressed(pressed, counts)[ELECTRODE_COLUMNS]))
        for counts in (predicted, measured)
    )
    alive = np.median(np.ptp(electrodes, axis=0)) > 0
    if alive and min(own, other) < _RAW_COUNTS and max(own, other) > _SURELY_RAW:
        found, expected = ("tared", "raw") if other < own else ("raw", "tared")
        raise RecordingError(
            f"the recordings' electrodes read {other:.0f} counts at the least force, so they look {found}, "
            f"and {model} gives {own:.0f}, as of {expected} counts: expected a model that was trained on "
            f"recordings of the same kind"
        )


def are_raw(rest: Floats) -> bool:
    """Whether resting counts (21,) are the converter's, and not differences from such."""
    return bool(np.median(rest[ELECTRODE_COLUMNS]) > _RAW_COUNTS)

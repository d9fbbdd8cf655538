"""Repeated frames: rows in which all electrodes hold the reading before, since a frame was lost."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import ELECTRODE_COLUMNS
from taxel_models.loop.basis import Floats
from taxel_models.loop.observations import Observations

LEAST_ROWS: Final = 2
"""Rows that repeat a frame: a single one is also how a slower sensor is read."""

LEAST_SHARE: Final = 0.01
"""Of all rows."""

AT_ONCE: Final = 0.25
"""Share of the electrodes that change where a frame begins and ends: a finger comes to rest more slowly."""

CUT_OFF: Final = 0.5
"""Share of the electrodes at an end of their range: a wave that is cut off there holds its counts, too."""

MOVING: Final = 0.5
"""Share of a frame's rows in which force or place change: what is held still repeats its counts, too."""


def repeated_frames(observations: Observations) -> NDArray[np.bool_]:
    """(n,) rows that repeat the frame before while the force or the place changed; none where they are few.

    That all electrodes keep their whole counts at once, and change together before and afterwards, has no
    other cause than a frame that is repeated.
    """
    begins = np.diff(observations.segment, prepend=-1) != 0
    changed = _changed(observations.measured[:, ELECTRODE_COLUMNS], begins)
    inputs = np.asarray(_changed(np.hstack([observations.force, observations.position]), begins) > 0)
    repeats: NDArray[np.bool_] = (changed == 0) & ~begins & ~_is_cut_off(observations)
    edges = np.diff(repeats.astype(np.int8), prepend=0, append=0)
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not len(starts):
        return np.zeros(len(repeats), np.bool_)
    after = np.minimum(stops, len(repeats) - 1)
    moved = np.add.reduceat(inputs, np.column_stack([starts, after]).ravel())[::2]
    # A run at an end of a segment has no edge there.
    whole_before = begins[starts - 1] | (changed[starts - 1] >= AT_ONCE)
    whole_after = begins[after] | (stops == len(repeats)) | (changed[after] >= AT_ONCE)
    lost = whole_before & whole_after & (moved >= MOVING * (stops - starts))
    long = lost & (stops - starts >= LEAST_ROWS)
    found = np.zeros(len(repeats), np.bool_)
    if (stops - starts)[long].sum() >= LEAST_SHARE * len(repeats):
        found[repeats] = np.repeat(lost, stops - starts)
    return found


def _is_cut_off(observations: Observations) -> NDArray[np.bool_]:
    """(n,) rows in which most electrodes are at an end of their range, such as 0 of tared counts."""
    electrodes = observations.measured[:, ELECTRODE_COLUMNS]
    at_end = (electrodes == electrodes.min(axis=0)) | (electrodes == electrodes.max(axis=0))
    return np.asarray(at_end.mean(axis=1) > CUT_OFF)


def held(values: Floats, repeated: NDArray[np.bool_]) -> Floats:
    """(n, c) with each repeated row in place of the last one that was read."""
    return values[np.maximum.accumulate(np.where(repeated, 0, np.arange(len(repeated))))]


def _changed(values: Floats, begins: NDArray[np.bool_]) -> Floats:
    """(n,) share of the columns that differ from the row before; 1 where a segment begins."""
    changed = (np.diff(values, axis=0, prepend=values[:1]) != 0).mean(axis=1)
    return np.asarray(np.where(begins, 1.0, changed))

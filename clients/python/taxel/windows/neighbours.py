"""The last and next contact position: where the contact was before, and will be after, it moved."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.windows.combinations import REACH, Position

MOVED_M: Final = 1e-6
"""A position differs from another when a coordinate does by more than this, m."""


def steps_of(which: Position) -> tuple[int, ...]:
    """The ticks, relative to T, that a position is looked for at, farthest first."""
    if which == "now":
        return (0,)
    direction = -1 if which == "last" else 1
    return tuple(direction * step for step in range(REACH, 0, -1))


def nearest_moved(
    now: NDArray[np.float64], farthest_first: Iterable[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """The nearest position that differs from `now`, else the farthest one, row by row.

    Args:
        now: (n, 3), m.
        farthest_first: the candidates, each (n, 3).
    """
    candidates = iter(farthest_first)
    found = next(candidates)
    for there in candidates:
        moved = (np.abs(there - now) > MOVED_M).any(axis=1, keepdims=True)
        found = np.where(moved, there, found)
    return found

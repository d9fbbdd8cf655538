"""The columns of a window, built alike from a whole recording and from a live stream."""

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.windows.combinations import REACH, Position, WindowSpec

MOVED_M: Final = 1e-6
"""Two positions differ if one of their coordinates differs by more than this, m."""

AtStep = Callable[[int], NDArray[np.float64]]
"""Values (n, 3) of the tick `step` ticks after the middle of each window."""


def window_columns(spec: WindowSpec, position: AtStep, force: AtStep) -> list[NDArray[np.float64]]:
    """The columns of n windows, each (n, 3), in the order of `WindowSpec.features`.

    Args:
        position: contact positions at a step, m.
        force: contact forces at a step, N.
    """
    return position_columns(spec, position) + [force(step) for step in spec.force_steps]


def position_columns(spec: WindowSpec, position: AtStep) -> list[NDArray[np.float64]]:
    """The positions among the columns of n windows, each (n, 3)."""
    now = position(0)
    return [
        now if which == "now" else _nearest_moved(now, map(position, steps_of(which)))
        for which in spec.positions
    ]


def steps_of(which: Position) -> tuple[int, ...]:
    """The steps of the candidates for a position, the farthest first."""
    if which == "now":
        return (0,)
    direction = -1 if which == "last" else 1
    return tuple(direction * step for step in range(REACH, 0, -1))


def _nearest_moved(
    now: NDArray[np.float64], farthest_first: Iterable[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """For each row, the nearest position that differs from `now`; if none does, the farthest.

    Args:
        now: (n, 3), m.
        farthest_first: the candidates, each (n, 3).
    """
    candidates = iter(farthest_first)
    found = next(candidates)
    for candidate in candidates:
        moved = (np.abs(candidate - now) > MOVED_M).any(axis=1, keepdims=True)
        found = np.where(moved, candidate, found)
    return found

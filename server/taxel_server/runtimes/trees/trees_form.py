"""The form of a forest for few rows: small trees side by side, large ones as linked nodes."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.columns import Columns
from taxel_server.runtimes.trees.forest import Forest
from taxel_server.runtimes.trees.in_order import InOrder
from taxel_server.runtimes.trees.lookups import can_look_up
from taxel_server.runtimes.trees.plans import Scratch, pack, together
from taxel_server.runtimes.trees.scales import Scales
from taxel_server.runtimes.trees.trees_evaluation import (
    TILE,
    WALKERS,
    Large,
    Small,
    Sums,
    TreesScratch,
    evaluate_trees,
)
from taxel_server.runtimes.trees.trees_in_lanes import find_exits, trees_at_once
from taxel_server.runtimes.trees.trees_layout import TABLE_SIZES, Linked, SideBySide

_MOST_LEAVES: Final = 127
"""Leaves of the largest tree whose exits fit signed bytes, and leave one value to block a lane."""


class TreesKernel:
    """A forest compiled for few rows; each thread needs a scratch of its own."""

    def __init__(self, forest: Forest, index: InOrder, scales: Scales) -> None:
        small, columns = _small_trees(index)
        large = np.flatnonzero(~small)
        linked = Linked.of(forest, index, Columns.of(index, 16, large), large)
        outputs = len(forest.base_score)
        width = -(-outputs // 8) * 8
        seat = _rounds(forest) * width + forest.outputs
        rounds = int(_rounds(forest).max(initial=-1)) + 1
        every = (np.arange(rounds)[:, None] * width + np.arange(outputs)).ravel()
        self._sums = Sums(rounds, width, np.setdiff1d(every, seat), forest.base_score)
        side = SideBySide.of(index, columns, np.flatnonzero(small), trees_at_once())
        seats = np.where(side.tree >= 0, seat[side.tree], rounds * width).astype(np.int32)
        nodes, leaves, seats = together(side.nodes, side.value, seats)
        self._small = Small(
            find_exits(side.size) if len(side.steps) else 0,
            side.steps,
            side.start,
            nodes.ctypes.data,
            trees_at_once(),
            side.size,
            side.leaf_start,
            leaves.ctypes.data,
            seats.ctypes.data,
        )
        self._large = Large(
            linked.root,
            linked.nodes.ctypes.data,
            linked.value,
            seat[large],
            len(linked.columns) + 1,
        )
        self._kept = (columns, nodes, leaves, seats, linked, scales)
        self._plan = pack(
            columns.ranking, linked.columns.ranking, self._small, self._large, self._sums, scales
        )

    def scratch(self) -> Scratch:
        """Memory for one evaluation at a time."""
        return Scratch(
            TreesScratch(
                np.zeros(TILE * self._small.ranks, dtype=np.int8),
                np.zeros(TILE * self._large.ranks, dtype=np.uint16),
                np.empty(TILE * self._small.lanes, dtype=np.uint8),
                np.zeros(TILE * (self._sums.rounds + 1) * self._sums.width, dtype=np.float32),
                np.empty(TILE * self._sums.width, dtype=np.float32),
                np.empty(2 * WALKERS, dtype=np.int64),
            )
        )

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32], scratch: Scratch) -> None:
        """Fills `result` (n, outputs) with what the forest says of `windows` (n, features)."""
        evaluate_trees(self._plan, scratch.plan, windows, result)


def _small_trees(index: InOrder) -> tuple[NDArray[np.bool_], Columns]:
    """Which trees go side by side, and their columns: none where the processor cannot look ranks up."""
    small = index.leaves <= _MOST_LEAVES
    if can_look_up():
        columns = Columns.of(index, 8, np.flatnonzero(small))
        if len(columns) <= TABLE_SIZES[-1]:
            return small, columns
    none = np.zeros_like(small)
    return none, Columns.of(index, 8, np.flatnonzero(none))


def _rounds(forest: Forest) -> NDArray[np.int64]:
    """The place of each tree among those of its output."""
    order = np.argsort(forest.outputs, kind="stable")
    ordered = forest.outputs[order]
    rounds = np.empty(forest.trees, dtype=np.int64)
    rounds[order] = np.arange(forest.trees) - np.searchsorted(ordered, ordered)
    return rounds

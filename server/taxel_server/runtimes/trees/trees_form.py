"""The form of a forest for few rows: all trees find their leaf, then the leaves are summed in order."""

from typing import Final, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.calls import call
from taxel_server.runtimes.trees.columns import Columns, rank, ranking_at
from taxel_server.runtimes.trees.forest import Forest
from taxel_server.runtimes.trees.in_order import InOrder
from taxel_server.runtimes.trees.plans import Scratch, array_at, pack
from taxel_server.runtimes.trees.rows_layout import MOST_LEAVES
from taxel_server.runtimes.trees.scales import Scales, scales_at
from taxel_server.runtimes.trees.trees_in_lanes import find_exits, trees_at_once
from taxel_server.runtimes.trees.trees_layout import TABLE_SIZES, Linked, SideBySide
from taxel_server.runtimes.trees.vectors import can_look_up, float_at, integer_at, put_float

TILE: Final = 8
"""Rows whose leaves are kept side by side until they are summed."""

_WALKERS: Final = 8
"""Walks that advance in turn, so that one need not wait for another's memory."""


class _Small(NamedTuple):
    """Trees side by side, and by lane their seat among the leaves to sum."""

    traversal: int
    steps: NDArray[np.int64]
    start: NDArray[np.int64]
    nodes: int
    lanes: int
    ranks: int
    leaf_start: NDArray[np.int64]
    leaves: int
    seats: int


class _Large(NamedTuple):
    """Linked trees and their seats."""

    root: NDArray[np.int64]
    column: NDArray[np.uint16]
    limit: NDArray[np.int16]
    left: NDArray[np.int32]
    value: NDArray[np.float32]
    seat: NDArray[np.int64]
    ranks: int


class _Sums(NamedTuple):
    rounds: int
    width: int
    empty: NDArray[np.int64]
    base_score: NDArray[np.float32]


class _Scratch(NamedTuple):
    small_ranks: NDArray[np.int8]
    large_ranks: NDArray[np.int16]
    exits: NDArray[np.uint8]
    leaves: NDArray[np.float32]
    sums: NDArray[np.float32]
    walkers: NDArray[np.int64]


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
        self._sums = _Sums(rounds, width, np.setdiff1d(every, seat), forest.base_score)
        side = SideBySide.of(index, columns, np.flatnonzero(small), trees_at_once())
        seats = np.where(side.tree >= 0, seat[side.tree], rounds * width).astype(np.int32)
        self._small = _Small(
            find_exits(side.size) if len(side.steps) else 0,
            side.steps,
            side.start,
            side.nodes.ctypes.data,
            trees_at_once(),
            side.size,
            side.leaf_start,
            side.value.ctypes.data,
            seats.ctypes.data,
        )
        self._large = _Large(
            linked.root,
            linked.nodes["column"].copy(),
            linked.nodes["limit"].copy(),
            linked.nodes["left"].copy(),
            linked.value,
            seat[large],
            len(linked.columns) + 1,
        )
        self._kept = (side, seats, linked, scales)
        self._plan = pack(
            columns.ranking, linked.columns.ranking, self._small, self._large, self._sums, scales
        )

    def scratch(self) -> Scratch:
        """Memory for one evaluation at a time."""
        return Scratch(
            _Scratch(
                np.zeros(TILE * self._small.ranks, dtype=np.int8),
                np.full(TILE * self._large.ranks, -32768, dtype=np.int16),
                np.empty(TILE * self._small.lanes, dtype=np.uint8),
                np.zeros(TILE * (self._sums.rounds + 1) * self._sums.width, dtype=np.float32),
                np.empty(TILE * self._sums.width, dtype=np.float32),
                np.empty(_WALKERS, dtype=np.int64),
            )
        )

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32], scratch: Scratch) -> None:
        """Fills `result` (n, outputs) with what the forest says of `windows` (n, features)."""
        _evaluate(self._plan, scratch.plan, windows, result)


def _small_trees(index: InOrder) -> tuple[NDArray[np.bool_], Columns]:
    """Which trees go side by side, and their columns: none where the processor cannot look ranks up."""
    small = index.leaves <= MOST_LEAVES[8]
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


@numba.njit(cache=True, nogil=True)
def _rank_rows(ranking, scales, windows, first, rows, highest, size, ranks):  # type: ignore[no-untyped-def]
    """Ranks [row][column], less half their range."""
    bias = (highest + 1) // 2
    for row in range(rows):
        for column in range(ranking.feature.size):
            feature = ranking.feature[column]
            x = windows[first + row, feature]
            if scales.applied:
                x = (x - scales.input_mean[feature]) / scales.input_std[feature]
            start, stop = ranking.start[column], ranking.start[column + 1]
            place = rank(x, ranking.cuts[start:stop], ranking.default_left[column], highest)
            ranks[row * size + column] = place - bias


@numba.njit(cache=True, nogil=True)
def _visit_small(small, scratch, rows):  # type: ignore[no-untyped-def]
    lanes = small.lanes
    exits, leaves = scratch.exits.ctypes.data, scratch.leaves.ctypes.data
    for group in range(small.steps.size):
        nodes, steps = small.nodes + small.start[group], small.steps[group]
        call(small.traversal, nodes, steps, scratch.small_ranks.ctypes.data, rows, exits)
        table = small.leaves + 4 * small.leaf_start[group]
        seats = small.seats + 4 * group * lanes
        if rows == 1:
            for lane in range(lanes):
                place = leaves + 4 * integer_at(seats + 4 * lane, 32)
                put_float(place, float_at(table + 4 * integer_at(exits + lane, 8)))
                table += 4 * (steps + 1)
            continue
        for lane in range(lanes):
            place = leaves + 4 * rows * integer_at(seats + 4 * lane, 32)
            found = exits + lane
            for row in range(rows):
                put_float(place + 4 * row, float_at(table + 4 * integer_at(found, 8)))
                found += lanes
            table += 4 * (steps + 1)


@numba.njit(cache=True, nogil=True)
def _visit_large(large, scratch, rows):  # type: ignore[no-untyped-def]
    """Every tree with every row is a walk; they advance together, in handfuls, until none moves."""
    walks = large.root.size * rows
    node = scratch.walkers
    for first in range(0, walks, _WALKERS):
        count = min(_WALKERS, walks - first)
        for walker in range(count):
            node[walker] = large.root[(first + walker) // rows]
        moving = True
        while moving:
            moving = False
            for walker in range(count):
                place = node[walker]
                rank = scratch.large_ranks[(first + walker) % rows * large.ranks + large.column[place]]
                after = large.left[place] + (rank >= large.limit[place])
                moving |= after != place
                node[walker] = after
        for walker in range(count):
            tree, row = divmod(first + walker, rows)
            scratch.leaves[large.seat[tree] * rows + row] = large.value[node[walker]]


@numba.njit(cache=True, nogil=True)
def _sum(sums, scales, scratch, first, rows, result):  # type: ignore[no-untyped-def]
    """Adds the leaves in the order of the trees, all outputs side by side."""
    outputs = sums.base_score.size
    length = sums.width * rows
    for seat in sums.empty:
        # Adding -0.0 changes no float, whereas 0.0 would change -0.0.
        scratch.leaves[seat * rows : (seat + 1) * rows] = np.float32(-0.0)
    total = scratch.sums[:length]
    for output in range(outputs):
        total[output * rows : (output + 1) * rows] = sums.base_score[output]
    for place in range(sums.rounds):
        leaves = scratch.leaves[place * length : (place + 1) * length]
        for seat in range(length):
            total[seat] += leaves[seat]
    for row in range(rows):
        for output in range(outputs):
            value = total[output * rows + row]
            if scales.applied:
                value = value * scales.output_std[output] + scales.output_mean[output]
            result[first + row, output] = value


@numba.njit(cache=True)
def _small_at(plan, entry):  # type: ignore[no-untyped-def]
    return _Small(
        plan[entry, 0],
        array_at(plan, entry + 1, np.int64),
        array_at(plan, entry + 2, np.int64),
        plan[entry + 3, 0],
        plan[entry + 4, 0],
        plan[entry + 5, 0],
        array_at(plan, entry + 6, np.int64),
        plan[entry + 7, 0],
        plan[entry + 8, 0],
    )


@numba.njit(cache=True)
def _large_at(plan, entry):  # type: ignore[no-untyped-def]
    return _Large(
        array_at(plan, entry, np.int64),
        array_at(plan, entry + 1, np.uint16),
        array_at(plan, entry + 2, np.int16),
        array_at(plan, entry + 3, np.int32),
        array_at(plan, entry + 4, np.float32),
        array_at(plan, entry + 5, np.int64),
        plan[entry + 6, 0],
    )


@numba.njit(cache=True)
def _sums_at(plan, entry):  # type: ignore[no-untyped-def]
    return _Sums(
        plan[entry, 0],
        plan[entry + 1, 0],
        array_at(plan, entry + 2, np.int64),
        array_at(plan, entry + 3, np.float32),
    )


@numba.njit(cache=True)
def _scratch_at(plan):  # type: ignore[no-untyped-def]
    return _Scratch(
        array_at(plan, 0, np.int8),
        array_at(plan, 1, np.int16),
        array_at(plan, 2, np.uint8),
        array_at(plan, 3, np.float32),
        array_at(plan, 4, np.float32),
        array_at(plan, 5, np.int64),
    )


@numba.njit(cache=True, nogil=True)
def _evaluate(plan, memory, windows, result):  # type: ignore[no-untyped-def]
    rank_small, rank_large = ranking_at(plan, 0), ranking_at(plan, 4)
    small, large, sums = _small_at(plan, 8), _large_at(plan, 17), _sums_at(plan, 24)
    scales, scratch = scales_at(plan, 28), _scratch_at(memory)
    for first in range(0, windows.shape[0], TILE):
        rows = min(TILE, windows.shape[0] - first)
        _rank_rows(rank_small, scales, windows, first, rows, 255, small.ranks, scratch.small_ranks)
        _rank_rows(rank_large, scales, windows, first, rows, 65535, large.ranks, scratch.large_ranks)
        _visit_small(small, scratch, rows)
        _visit_large(large, scratch, rows)
        _sum(sums, scales, scratch, first, rows, result)

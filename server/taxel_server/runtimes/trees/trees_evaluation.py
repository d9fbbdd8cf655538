"""Compiled: few rows through all trees, then the leaves summed in the order of the trees."""

from typing import Final, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.calls import call
from taxel_server.runtimes.trees.columns import rank, ranking_at
from taxel_server.runtimes.trees.plans import array_at
from taxel_server.runtimes.trees.scales import scales_at
from taxel_server.runtimes.trees.vectors import float_at, integer_at, put_float

TILE: Final = 8
"""Rows whose leaves are kept side by side until they are summed."""

WALKERS: Final = 16
"""Walks that advance in turn, so that one need not wait for another's memory."""


class Small(NamedTuple):
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


class Large(NamedTuple):
    """Linked trees and their seats."""

    root: NDArray[np.int64]
    nodes: int
    value: NDArray[np.float32]
    seat: NDArray[np.int64]
    ranks: int


class Sums(NamedTuple):
    """How leaves are summed: rounds of one seat an output, the seats that no tree takes, and the base.

    `width` is the number of outputs, padded to whole vectors.
    """

    rounds: int
    width: int
    empty: NDArray[np.int64]
    base_score: NDArray[np.float32]


class TreesScratch(NamedTuple):
    """What one evaluation writes to."""

    small_ranks: NDArray[np.int8]
    large_ranks: NDArray[np.uint16]
    exits: NDArray[np.uint8]
    leaves: NDArray[np.float32]
    sums: NDArray[np.float32]
    walkers: NDArray[np.int64]


@numba.njit(cache=True, nogil=True)
def _rank_rows(ranking, scales, windows, first, rows, highest, bias, size, ranks):  # type: ignore[no-untyped-def]
    """Ranks [row][column], less the bias."""
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
        call(small.traversal, (nodes, steps, scratch.small_ranks.ctypes.data, rows, exits))
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
    place, ranks = scratch.walkers[:WALKERS], scratch.walkers[WALKERS:]
    base = scratch.large_ranks.ctypes.data
    for first in range(0, walks, WALKERS):
        count = min(WALKERS, walks - first)
        for walker in range(count):
            tree, row = divmod(first + walker, rows)
            place[walker] = large.root[tree]
            ranks[walker] = base + 2 * row * large.ranks
        moving = True
        while moving:
            moving = False
            for walker in range(count):
                node = large.nodes + 8 * place[walker]
                rank = integer_at(ranks[walker] + 2 * integer_at(node, 16), 16)
                after = integer_at(node + 4, 32) + (rank >= integer_at(node + 2, 16))
                moving |= after != place[walker]
                place[walker] = after
        for walker in range(count):
            tree, row = divmod(first + walker, rows)
            scratch.leaves[large.seat[tree] * rows + row] = large.value[place[walker]]


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
    return Small(
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
    return Large(
        array_at(plan, entry, np.int64),
        plan[entry + 1, 0],
        array_at(plan, entry + 2, np.float32),
        array_at(plan, entry + 3, np.int64),
        plan[entry + 4, 0],
    )


@numba.njit(cache=True)
def _sums_at(plan, entry):  # type: ignore[no-untyped-def]
    return Sums(
        plan[entry, 0],
        plan[entry + 1, 0],
        array_at(plan, entry + 2, np.int64),
        array_at(plan, entry + 3, np.float32),
    )


@numba.njit(cache=True)
def _scratch_at(plan):  # type: ignore[no-untyped-def]
    return TreesScratch(
        array_at(plan, 0, np.int8),
        array_at(plan, 1, np.uint16),
        array_at(plan, 2, np.uint8),
        array_at(plan, 3, np.float32),
        array_at(plan, 4, np.float32),
        array_at(plan, 5, np.int64),
    )


@numba.njit(cache=True, nogil=True)
def evaluate_trees(plan, memory, windows, result):  # type: ignore[no-untyped-def]
    """Fills `result` (n, outputs); `plan` packs two rankings, Small, Large, Sums and the scales."""
    rank_small, rank_large = ranking_at(plan, 0), ranking_at(plan, 4)
    small, large, sums = _small_at(plan, 8), _large_at(plan, 17), _sums_at(plan, 22)
    scales, scratch = scales_at(plan, 26), _scratch_at(memory)
    for first in range(0, windows.shape[0], TILE):
        rows = min(TILE, windows.shape[0] - first)
        _rank_rows(rank_small, scales, windows, first, rows, 255, 128, small.ranks, scratch.small_ranks)
        _rank_rows(rank_large, scales, windows, first, rows, 65535, 0, large.ranks, scratch.large_ranks)
        _visit_small(small, scratch, rows)
        _visit_large(large, scratch, rows)
        _sum(sums, scales, scratch, first, rows, result)

"""Kernels for few rows.

First each row's values become ranks among the cuts of every column; sixteen cuts are compared at once. Then
every lane of a vector is a tree, and one row after another visits them.
"""

from functools import cache
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import address_of, compiled
from taxel_server.runtimes.compiled.processor import register_bytes
from taxel_server.runtimes.compiled.vectors import (
    add,
    count,
    greater,
    integer_at,
    load,
    load_floats,
    lowest_bits,
    minus,
    neither,
    not_above,
    plus,
    plus_saturated,
    prefetch,
    select,
    splat,
    splat_float,
    store,
)
from taxel_server.runtimes.trees.layout.columns import BIAS, Columns, Cuts
from taxel_server.runtimes.trees.layout.tree_lanes import (
    COLUMN_BITS,
    COLUMNS_AT,
    LIMITS_AT,
    LINE,
    MASKS_AT,
)
from taxel_server.runtimes.trees.normalisation import Scales
from taxel_server.runtimes.trees.simd.lookups import interleave, lookup
from taxel_server.runtimes.trees.simd.vectors64 import (
    bytes_at,
    elements,
    floats_at,
    lowest_common_bit,
    widen,
)

ROWS: Final = 8
"""How many rows are ranked and go through a group of trees at once."""

OUTPUTS_AT_ONCE: Final = 8
"""Trees whose leaves are added at once, each tree's to another output."""

_CUTS_AT_ONCE: Final = 16
"""How many cuts are compared at once: a cache line of float32."""

_MISSING_GOES_RIGHT: Final = 255
_MASKS: Final = 8 * OUTPUTS_AT_ONCE
_MOST_LANES: Final = 128
_AHEAD: Final = 4096
"""How many bytes ahead leaves are prefetched: the processor by itself does not prefetch beyond a page."""


def padded_cuts(columns: Columns) -> Cuts:
    """The cuts of columns, each column's a whole number of cache lines. `together` aligns them.

    NaN, which is never <= x, fills a column's last line.
    """
    feature, default_left, starts, cuts = columns.cuts
    padded = [np.empty(0, dtype=np.float32)]
    for first, stop in pairwise(starts):
        padded += [cuts[first:stop], np.full(-(stop - first) % _CUTS_AT_ONCE, np.nan, dtype=np.float32)]
    lengths = -(-np.diff(starts) // _CUTS_AT_ONCE) * _CUTS_AT_ONCE
    return Cuts(feature, default_left, np.cumsum([0, *lengths]), np.concatenate(padded))


@compiled
def rank_rows(
    columns: Cuts,
    scales: Scales,
    windows: NDArray[np.float32],
    first: int,
    rows: int,
    size: int,
    ranks: NDArray[np.int8],
) -> None:
    """Writes the ranks [row][column] of some rows, less BIAS; a row takes `size` bytes.

    A missing value gets the lowest rank in columns whose nodes send it left, and the highest in others.
    """
    cuts = columns.cuts.ctypes.data
    for column in range(columns.feature.size):
        feature = columns.feature[column]
        for row in range(rows):
            x = windows[first + row, feature]
            if scales.applied:
                x = (x - scales.input_mean[feature]) / scales.input_std[feature]
            rank, everywhere = 0, splat_float(x, _CUTS_AT_ONCE)
            for place in range(columns.start[column], columns.start[column + 1], _CUTS_AT_ONCE):
                rank += count(not_above(load_floats(cuts + 4 * place, _CUTS_AT_ONCE), everywhere))
            if np.isnan(x) and not columns.default_left[column]:
                rank = _MISSING_GOES_RIGHT
            ranks[row * size + column] = rank - BIAS


def trees_at_once() -> int:
    """Trees of a group: four registers, so that chains of dependent steps overlap.

    A group takes as long as its largest tree, so more lanes would wait longer.
    """
    return min(4 * register_bytes(), _MOST_LANES)


@cache
def find_exits(columns: int, bits: int, packed: bool, prefetches: bool) -> int:
    """Compiles the traversal of one group's top trees and gives its address.

    The function takes:
        the address of the group's nodes, laid out as `TopTrees` says
        the number of steps
        the address of the ranks [row][column]
        the number of rows
        the address of the exits [row][tree], which it writes
        the address of memory that is needed later

    At a node, a row goes right if its rank is not below the limit. The exit then becomes the block behind
    the node, unless the row has left the node's subtree before. It is still inside if the node's distance
    is no less than the number of steps since the exit last changed.

    Args:
        columns: the length of a row's ranks: 16, 32, 48, 64, 128 or 256.
        bits: the size of an exit, 8 or 16.
        packed: whether the nodes are packed.
        prefetches: whether each step prefetches one cache line of the next group's nodes and one of the
            memory that is needed later.
    """
    return _find_packed_exits(columns, prefetches) if packed else _find_exits(columns, bits, prefetches)


def _find_exits(columns: int, bits: int, prefetches: bool) -> int:
    lanes = trees_at_once()
    size = (2 + bits // 8) * lanes

    @address_of("void(intp, intp, intp, intp, intp, intp)")
    def traverse(nodes: int, steps: int, ranks: int, rows: int, exits: int, later: int) -> None:
        soon = nodes + size * steps
        never, step = splat(0, bits, lanes), splat(1, bits, lanes)
        for row in range(rows):
            table = ranks + row * columns
            node = nodes
            since = never
            for _ in range(steps):
                rank = lookup(table, columns, load(node, 8, lanes))
                goes_left = greater(load(node + lanes, 8, lanes), rank)
                passed_by = greater(since, load(node + 2 * lanes, bits, lanes))
                since = select(neither(goes_left, passed_by), never, plus(since, step))
                node += size
                if prefetches:
                    prefetch(soon, 1)
                    prefetch(later, 2)
                    soon, later = soon + 64, later + 64
            store(exits + row * lanes * (bits // 8), minus(splat(steps, bits, lanes), since))

    return traverse


def _find_packed_exits(columns: int, prefetches: bool) -> int:
    lanes = trees_at_once()
    size, least = 2 * lanes, 1 << COLUMN_BITS

    @address_of("void(intp, intp, intp, intp, intp, intp)")
    def traverse(nodes: int, steps: int, ranks: int, rows: int, exits: int, later: int) -> None:
        soon = nodes + size * steps
        never, step, further = splat(-128, 8, lanes), splat(1, 8, lanes), splat(least, 8, lanes)
        for row in range(rows):
            table = ranks + row * columns
            node = nodes
            since = never
            number = reached = splat(0, 8, lanes)
            for _ in range(steps):
                places = load(node, 8, lanes)
                rank = lookup(table, columns, lowest_bits(places, COLUMN_BITS))
                goes_left = greater(load(node + lanes, 8, lanes), rank)
                # A distance stands in the upper bits, above the column: bytes compare like distances.
                goes_right = neither(goes_left, greater(since, places))
                number = plus(number, step)
                reached = select(goes_right, number, reached)
                since = select(goes_right, never, plus_saturated(since, further))
                node += size
                if prefetches:
                    prefetch(soon, 1)
                    prefetch(later, 2)
                    soon, later = soon + 64, later + 64
            store(exits + row * lanes, reached)

    return traverse


@cache
def put_exits() -> int:
    """Compiles what copies one group's exits, a byte each, to the slots of its trees; gives its address.

    The function takes the addresses of:
        the exits [row][tree] of ROWS rows
        the trees' slots, in the order of `interleaved_lane`
        memory for a group's exits
        the exits [slot][row], which it writes
    """
    lanes, width = trees_at_once(), register_bytes()

    @address_of("void(intp, intp, intp, intp)")
    def put(exits: int, slots: int, memory: int, by_slot: int) -> None:
        for first in range(0, lanes, width):
            place = memory + ROWS * first
            for part in interleave(exits + first, lanes, width):
                store(place, part)
                place += width
        for lane in range(lanes):
            store(by_slot + 8 * integer_at(slots + 4 * lane, 32), integer_at(memory + 8 * lane, 64))

    return put


@cache
def add_leaves(prefetches: bool) -> int:
    """Compiles the sum of the leaves of one output's trees and gives its address.

    The function takes:
        the number of trees
        the address of each tree's number of leaves, a byte each
        the address of the first tree's leaves
        the address of the exits [tree][row] of ROWS rows
        the address of the sums [row], which start as the base score
        how many cache lines the leaves of a tree take on average

    Args:
        prefetches: whether leaves are prefetched.
    """

    @address_of("void(intp, intp, intp, intp, intp, intp)")
    def add_all(trees: int, counts: int, leaves: int, exits: int, sums: int, lines: int) -> None:
        total = load_floats(sums, ROWS)
        for tree in range(trees):
            total = add(total, floats_at(elements(leaves, widen(load(exits + 8 * tree, 8, ROWS)), 4)))
            if prefetches:
                for soon in range(leaves + _AHEAD, leaves + _AHEAD + 64 * lines, 64):
                    prefetch(soon, 1)
            leaves += 4 * integer_at(counts + tree, 8)
        store(sums, total)

    return add_all


@cache
def find_blocks(bits: int) -> int:
    """Compiles what turns one group's exits into addresses of leaf blocks; gives its address.

    The function takes:
        the address of the pointers [lane] to each tree's first block, which it moves to the next trees
        the address of the trees' numbers of blocks [lane]
        the number of rows
        the address of the exits [row][tree]
        the address of the blocks' addresses [row][tree], which it writes

    Args:
        bits: the size of an exit and of a number of blocks, 8 or 16.
    """
    lanes, size = trees_at_once(), bits // 8

    @address_of("void(intp, intp, intp, intp, intp)")
    def find(first: int, counts: int, rows: int, exits: int, places: int) -> None:
        for lane in range(0, lanes, OUTPUTS_AT_ONCE):
            start = load(first + 8 * lane, 64, OUTPUTS_AT_ONCE)
            for row in range(rows):
                tree = row * lanes + lane
                reached = widen(load(exits + tree * size, bits, OUTPUTS_AT_ONCE))
                store(places + 8 * tree, plus(start, elements(0, reached, LINE)))
            blocks = widen(load(counts + lane * size, bits, OUTPUTS_AT_ONCE))
            store(first + 8 * lane, plus(start, elements(0, blocks, LINE)))

    return find


@cache
def add_blocks(columns: int, prefetches: bool) -> int:
    """Compiles the sum of the leaves that rows reach in one group's leaf blocks; gives its address.

    The function takes:
        the address of the ranks [row][column]
        the number of rows
        the address of the blocks' addresses [row][tree]
        the same of the next group
        the address of memory for the group's leaves [row][tree]
        the number of the group's rounds
        the number of outputs of a round
        the address of the sums [row][output], padded to a multiple of OUTPUTS_AT_ONCE
        how many bytes a row of the sums takes

    Args:
        columns: the length of a row's ranks.
        prefetches: whether the next group's blocks are prefetched.
    """
    lanes = trees_at_once()

    @address_of("void(intp, intp, intp, intp, intp, intp, intp, intp, intp)")
    def add_all(
        ranks: int,
        rows: int,
        places: int,
        ahead: int,
        leaves: int,
        rounds: int,
        outputs: int,
        sums: int,
        width: int,
    ) -> None:
        for lane in range(0, lanes, OUTPUTS_AT_ONCE):
            for row in range(rows):
                tree = row * lanes + lane
                if prefetches:
                    for soon in range(ahead + 8 * tree, ahead + 8 * (tree + OUTPUTS_AT_ONCE), 8):
                        prefetch(integer_at(soon, 64), 1)
                block = load(places + 8 * tree, 64, OUTPUTS_AT_ONCE)
                rank = lookup(ranks + row * columns, columns, bytes_at(block, COLUMNS_AT))
                goes_left = greater(bytes_at(block, LIMITS_AT), rank)
                reachable = select(goes_left, splat(-1, 8, _MASKS), bytes_at(block, MASKS_AT))
                leaf = floats_at(plus(block, elements(0, lowest_common_bit(reachable), 4)))
                store(leaves + 4 * tree, leaf)
        for row in range(rows):
            for output in range(0, outputs, OUTPUTS_AT_ONCE):
                total = load_floats(sums + row * width + 4 * output, OUTPUTS_AT_ONCE)
                leaf = leaves + 4 * (row * lanes + output)
                for _ in range(rounds):
                    total = add(total, load_floats(leaf, OUTPUTS_AT_ONCE))
                    leaf += 4 * outputs
                store(sums + row * width + 4 * output, total)

    return add_all

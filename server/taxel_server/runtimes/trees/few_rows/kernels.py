"""Kernels for few rows: every lane of a vector is a tree, and one row after another visits them."""

from functools import cache
from typing import Final

from taxel_server.runtimes.compiled.compiling import address_of
from taxel_server.runtimes.compiled.processor import register_bytes
from taxel_server.runtimes.compiled.vectors import (
    add,
    greater,
    integer_at,
    load,
    load_floats,
    lowest_bits,
    minus,
    neither,
    plus,
    plus_saturated,
    prefetch,
    put_int64,
    select,
    splat,
    store,
)
from taxel_server.runtimes.trees.few_rows.ranks import ROWS
from taxel_server.runtimes.trees.layout.tree_lanes import (
    COLUMN_BITS,
    COLUMNS_AT,
    LIMITS_AT,
    LINE,
    MASKS_AT,
)
from taxel_server.runtimes.trees.simd.lookups import interleave, lookup
from taxel_server.runtimes.trees.simd.vectors64 import (
    bytes_at,
    elements,
    floats_at,
    lowest_common_bit,
    widen,
)

OUTPUTS_AT_ONCE: Final = 8
"""Trees whose leaves are added at once, each to an output of its own."""

_MASKS: Final = 8 * OUTPUTS_AT_ONCE
_MOST_LANES: Final = 128
_AHEAD: Final = 4096
"""Bytes by which leaves are asked for ahead: the processor by itself does not look beyond a page."""


def trees_at_once() -> int:
    """Trees of a group: some registers of them, so that chains of dependent steps overlap.

    More lanes would only wait for the largest tree among them.
    """
    return min(4 * register_bytes(), _MOST_LANES)


@cache
def find_exits(columns: int, bits: int, packed: bool, asks: bool) -> int:
    """The address of the traversal of one group's top trees by some rows, compiled.

    The function takes the address of the group's nodes, laid out as TopTrees says; the number of
    steps; the address of the ranks [row][column]; the number of rows; and the address of the exits
    [row][tree], which it writes; at last the address of what is wanted later. `columns` is the length of a
    row's ranks: 16, 32, 48, 64, 128 or 256. If it `asks`, each step asks for a cache line of the nodes
    behind the group's, and for one of what is wanted.

    A row goes right at a node, and from then on the exit is the block behind the node, if no earlier block
    was reached than the first of the node's left subtree: if the node's distance is no less than the number
    of steps since the exit last changed.
    """
    return _find_packed_exits(columns, asks) if packed else _find_exits(columns, bits, asks)


def _find_exits(columns: int, bits: int, asks: bool) -> int:
    lanes = trees_at_once()
    size = (2 + bits // 8) * lanes

    @address_of("void(intp, intp, intp, intp, intp, intp)")
    def traverse(nodes: int, steps: int, ranks: int, rows: int, exits: int, wanted: int) -> None:
        soon = nodes + size * steps
        never, one = splat(0, bits, lanes), splat(1, bits, lanes)
        for row in range(rows):
            table = ranks + row * columns
            node = nodes
            since = never
            for _ in range(steps):
                rank = lookup(table, columns, load(node, 8, lanes))
                goes_left = greater(load(node + lanes, 8, lanes), rank)
                passed_by = greater(since, load(node + 2 * lanes, bits, lanes))
                since = select(neither(goes_left, passed_by), never, plus(since, one))
                node += size
                if asks:
                    prefetch(soon, 1)
                    prefetch(wanted, 2)
                    soon, wanted = soon + 64, wanted + 64
            store(exits + row * lanes * (bits // 8), minus(splat(steps, bits, lanes), since))

    return traverse


def _find_packed_exits(columns: int, asks: bool) -> int:
    lanes = trees_at_once()
    size, least = 2 * lanes, 1 << COLUMN_BITS

    @address_of("void(intp, intp, intp, intp, intp, intp)")
    def traverse(nodes: int, steps: int, ranks: int, rows: int, exits: int, wanted: int) -> None:
        soon = nodes + size * steps
        never, one, further = splat(-128, 8, lanes), splat(1, 8, lanes), splat(least, 8, lanes)
        for row in range(rows):
            table = ranks + row * columns
            node = nodes
            since = never
            number = reached = splat(0, 8, lanes)
            for _ in range(steps):
                places = load(node, 8, lanes)
                rank = lookup(table, columns, lowest_bits(places, COLUMN_BITS))
                goes_left = greater(load(node + lanes, 8, lanes), rank)
                # Distances are compared as they stand, above the columns.
                goes_right = neither(goes_left, greater(since, places))
                number = plus(number, one)
                reached = select(goes_right, number, reached)
                since = select(goes_right, never, plus_saturated(since, further))
                node += size
                if asks:
                    prefetch(soon, 1)
                    prefetch(wanted, 2)
                    soon, wanted = soon + 64, wanted + 64
            store(exits + row * lanes, reached)

    return traverse


@cache
def put_exits() -> int:
    """The address of what hands one group's exits, a byte each, to the slots of its trees, compiled.

    The function takes the addresses of the exits [row][tree] of ROWS rows, of the trees' slots by the
    order of `interleaved_lane`, of memory for a group's exits, and of the exits [slot][row], which it
    writes.
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
            put_int64(by_slot + 8 * integer_at(slots + 4 * lane, 32), integer_at(memory + 8 * lane, 64))

    return put


@cache
def add_leaves(asks: bool) -> int:
    """The address of the sum of the leaves of one output's trees, compiled.

    The function takes the number of trees, the addresses of their numbers of leaves, a byte each, of the
    leaves of the first one, of their exits [tree][row] of ROWS rows, and of the sums [row], which start as
    the base score; at last how many cache lines of leaves a tree takes, as a rule. If it `asks`, leaves are
    asked for before they are needed.
    """

    @address_of("void(intp, intp, intp, intp, intp, intp)")
    def add_all(trees: int, counts: int, leaves: int, exits: int, sums: int, lines: int) -> None:
        total = load_floats(sums, ROWS)
        for tree in range(trees):
            total = add(total, floats_at(elements(leaves, widen(load(exits + 8 * tree, 8, ROWS)), 4)))
            if asks:
                for soon in range(leaves + _AHEAD, leaves + _AHEAD + 64 * lines, 64):
                    prefetch(soon, 1)
            leaves += 4 * integer_at(counts + tree, 8)
        store(sums, total)

    return add_all


@cache
def find_blocks(bits: int) -> int:
    """The address of what turns one group's exits into the addresses of its trees' blocks, compiled.

    The function takes the address of the address of every lane's first block, which it moves on to the
    lane's next tree, and those of the trees' numbers of blocks; the number of rows; and the addresses of
    the exits [row][tree] and of the blocks' addresses [row][tree], which it writes. Exits and numbers of
    blocks take so many bits.
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
            count = widen(load(counts + lane * size, bits, OUTPUTS_AT_ONCE))
            store(first + 8 * lane, plus(start, elements(0, count, LINE)))

    return find


@cache
def add_blocks(columns: int, asks: bool) -> int:
    """The address of the sum of the leaves that some rows reach in one group's blocks, compiled.

    The function takes the address of the ranks; the number of rows; the addresses of the group's blocks'
    addresses [row][tree] and of the next group's, whose blocks it asks for, if it `asks`; that of memory
    for the group's leaves [row][tree]; how many rounds of how many outputs the group has; the address of
    the sums [row][output], which may be written up to OUTPUTS_AT_ONCE, and a row's bytes of them.
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
                if asks:
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

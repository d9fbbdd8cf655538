"""Evaluates many rows at once: every lane of a vector is a row, and all of them visit every node."""

from functools import cache
from typing import Final

import numba

from taxel_server.runtimes.trees.lookups import assemble, can_look_up, gather, lookup, register_bytes
from taxel_server.runtimes.trees.rows_layout import INTERLEAVED
from taxel_server.runtimes.trees.vectors import (
    add,
    greater,
    integer_at,
    load,
    load_floats,
    select,
    splat,
    splat_at,
    store,
    unbias,
)

_REGISTERS: Final = 8
"""Vector registers that may hold exits, so that the rest of a step needs no memory."""

_SIGNATURE: Final = "void(intp, intp, intp, intp, intp)"


@numba.njit(inline="always")
def _step(reached, node, ranks, column, after, bits, lanes):  # type: ignore[no-untyped-def]
    """What the exits become when one node has been looked at; -1 blocks a lane that goes left.

    `column` is the number of bytes from one column's ranks to the next's.
    """
    rank = load(ranks + integer_at(node, 16) * column, bits, lanes)
    goes_left = greater(splat_at(node + 2, bits, lanes), rank)
    first = select(goes_left, splat(-1, bits, lanes), splat_at(node + 2 + bits // 8, bits, lanes))
    return select(greater(first, reached), reached, after)


@cache
def find_exits(bits: int, lanes: int) -> int:
    """The address of the traversal of some groups by a block of rows, compiled.

    The function takes the number of groups and the addresses of the first group, all records, the
    block's ranks [column][lane] and its exits [place][lane], unsigned, which it writes.
    """
    registers = lanes * bits // 8 // register_bytes()
    if INTERLEAVED * registers <= _REGISTERS:
        return _four_trees_at_once(bits, lanes)
    return _one_tree_at_once(bits, lanes, lanes * _REGISTERS // max(registers, _REGISTERS))


def _four_trees_at_once(bits: int, lanes: int) -> int:
    size, column = bits // 2, lanes * bits // 8
    lowest = -(2 ** (bits - 1))

    @numba.cfunc(_SIGNATURE, cache=True)
    def traverse(count, groups, records, ranks, exits):  # type: ignore[no-untyped-def]
        for _ in range(count):
            node = records + size * integer_at(groups, 64)
            steps = integer_at(groups + 8, 64)
            exit0 = splat(lowest, bits, lanes)
            exit1 = exit0
            exit2 = exit0
            exit3 = exit0
            for step in range(1, steps + 1):
                after = splat(step + lowest, bits, lanes)
                exit0 = _step(exit0, node, ranks, column, after, bits, lanes)
                exit1 = _step(exit1, node + size, ranks, column, after, bits, lanes)
                exit2 = _step(exit2, node + 2 * size, ranks, column, after, bits, lanes)
                exit3 = _step(exit3, node + 3 * size, ranks, column, after, bits, lanes)
                node += 4 * size
            store(exits + integer_at(groups + 16, 64) * lanes, unbias(exit0))
            store(exits + integer_at(groups + 24, 64) * lanes, unbias(exit1))
            store(exits + integer_at(groups + 32, 64) * lanes, unbias(exit2))
            store(exits + integer_at(groups + 40, 64) * lanes, unbias(exit3))
            groups += 48

    return int(traverse.address)


def _one_tree_at_once(bits: int, lanes: int, part: int) -> int:
    size, column = bits // 2, lanes * bits // 8
    lowest = -(2 ** (bits - 1))

    @numba.cfunc(_SIGNATURE, cache=True)
    def traverse(count, groups, records, ranks, exits):  # type: ignore[no-untyped-def]
        for _ in range(count):
            steps = integer_at(groups + 8, 64)
            for member in range(4):
                place = exits + integer_at(groups + 16 + 8 * member, 64) * lanes
                for first in range(0, column, part * bits // 8):
                    node = records + size * (integer_at(groups, 64) + member)
                    reached = splat(lowest, bits, part)
                    for step in range(1, steps + 1):
                        after = splat(step + lowest, bits, part)
                        reached = _step(reached, node, ranks + first, column, after, bits, part)
                        node += 4 * size
                    store(place + first, unbias(reached))
            groups += 48

    return int(traverse.address)


@numba.njit(inline="always")
def _leaves(planes, exits, size, lanes):  # type: ignore[no-untyped-def]
    """The leaves at some exits, each of their four bytes looked up by itself."""
    places = load(exits, 8, lanes)
    return assemble(
        lookup(planes, size, places),
        lookup(planes + size, size, places),
        lookup(planes + 2 * size, size, places),
        lookup(planes + 3 * size, size, places),
    )


@cache
def add_leaves(lanes: int) -> int:
    """The address of the sum of one output's leaves, tree after tree, compiled.

    The function takes the number of trees and the addresses of the first LEAVES entry, the leaf
    tables, the block's exits and its sums, which start as the base score.
    """
    part = min(lanes, register_bytes())
    return _add_looked_up(lanes, part) if can_look_up() else _add_gathered(lanes, part)


def _add_looked_up(lanes: int, part: int) -> int:
    @numba.cfunc(_SIGNATURE, cache=True)
    def add_trees(count, trees, tables, exits, sums):  # type: ignore[no-untyped-def]
        for first in range(0, lanes, part):
            total = load_floats(sums + 4 * first, part)
            for tree in range(trees, trees + 16 * count, 16):
                table = tables + integer_at(tree, 64)
                places = exits + integer_at(tree + 8, 32) * lanes + first
                kind = integer_at(tree + 12, 32)
                if kind == 1:
                    total = add(total, _leaves(table, places, 16, part))
                elif kind == 2:
                    total = add(total, _leaves(table, places, 32, part))
                elif kind == 3:
                    total = add(total, _leaves(table, places, 48, part))
                elif kind == 4:
                    total = add(total, _leaves(table, places, 64, part))
                elif kind == 8:
                    total = add(total, _leaves(table, places, 128, part))
                else:
                    total = add(total, gather(table, places + first, 16, part))
            store(sums + 4 * first, total)

    return int(add_trees.address)


def _add_gathered(lanes: int, part: int) -> int:
    @numba.cfunc(_SIGNATURE, cache=True)
    def add_trees(count, trees, tables, exits, sums):  # type: ignore[no-untyped-def]
        for first in range(0, lanes, part):
            total = load_floats(sums + 4 * first, part)
            for tree in range(trees, trees + 16 * count, 16):
                table = tables + integer_at(tree, 64)
                places = exits + integer_at(tree + 8, 32) * lanes + first
                if integer_at(tree + 12, 32) == 0:
                    total = add(total, gather(table, places, 8, part))
                else:
                    total = add(total, gather(table, places + first, 16, part))
            store(sums + 4 * first, total)

    return int(add_trees.address)

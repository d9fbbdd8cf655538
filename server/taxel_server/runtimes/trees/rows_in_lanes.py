"""Evaluates many rows at once: every lane of a vector is a row, and all of them visit every node."""

from functools import cache

import numba

from taxel_server.runtimes.trees.vectors import (
    add,
    assemble,
    can_look_up,
    gather,
    greater,
    integer_at,
    load,
    load_floats,
    lookup,
    register_bytes,
    select,
    splat,
    splat_at,
    store,
    unbias,
)


@numba.njit(inline="always")  # type: ignore[untyped-decorator]
def _step(reached, node, ranks, after, bits, lanes):  # type: ignore[no-untyped-def]
    """What the exits become when one node has been looked at; -1 blocks a lane that goes left."""
    rank = load(ranks + integer_at(node, 16) * (lanes * bits // 8), bits, lanes)
    goes_left = greater(splat_at(node + 2, bits, lanes), rank)
    first = select(goes_left, splat(-1, bits, lanes), splat_at(node + 2 + bits // 8, bits, lanes))
    return select(greater(first, reached), reached, after)


@cache
def find_exits(bits: int, lanes: int) -> int:
    """The address of the traversal of some groups by a block of rows, compiled.

    The function takes the number of groups and the addresses of the first group, all records, the
    block's ranks [column][lane] and its exits [place][lane], unsigned, which it writes.
    """
    size = bits // 2
    lowest = -(2 ** (bits - 1))

    if lanes > 64:

        @numba.cfunc("void(intp, intp, intp, intp, intp)", cache=True)  # type: ignore[untyped-decorator]
        def one_tree_at_once(count, groups, records, ranks, exits):  # type: ignore[no-untyped-def]
            for _ in range(count):
                for member in range(4):
                    node = records + size * (integer_at(groups, 64) + member)
                    reached = splat(lowest, bits, lanes)
                    for step in range(1, integer_at(groups + 8, 64) + 1):
                        reached = _step(reached, node, ranks, splat(step + lowest, bits, lanes), bits, lanes)
                        node += 4 * size
                    store(exits + integer_at(groups + 16 + 8 * member, 64) * lanes, unbias(reached))
                groups += 48

        return int(one_tree_at_once.address)

    @numba.cfunc("void(intp, intp, intp, intp, intp)", cache=True)  # type: ignore[untyped-decorator]
    def four_trees_at_once(count, groups, records, ranks, exits):  # type: ignore[no-untyped-def]
        for _ in range(count):
            node = records + size * integer_at(groups, 64)
            steps = integer_at(groups + 8, 64)
            exit0 = splat(lowest, bits, lanes)
            exit1 = exit0
            exit2 = exit0
            exit3 = exit0
            for step in range(1, steps + 1):
                after = splat(step + lowest, bits, lanes)
                exit0 = _step(exit0, node, ranks, after, bits, lanes)
                exit1 = _step(exit1, node + size, ranks, after, bits, lanes)
                exit2 = _step(exit2, node + 2 * size, ranks, after, bits, lanes)
                exit3 = _step(exit3, node + 3 * size, ranks, after, bits, lanes)
                node += 4 * size
            store(exits + integer_at(groups + 16, 64) * lanes, unbias(exit0))
            store(exits + integer_at(groups + 24, 64) * lanes, unbias(exit1))
            store(exits + integer_at(groups + 32, 64) * lanes, unbias(exit2))
            store(exits + integer_at(groups + 40, 64) * lanes, unbias(exit3))
            groups += 48

    return int(four_trees_at_once.address)


@numba.njit(inline="always")  # type: ignore[untyped-decorator]
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

    if can_look_up():

        @numba.cfunc("void(intp, intp, intp, intp, intp)", cache=True)  # type: ignore[untyped-decorator]
        def by_bytes(count, trees, tables, exits, sums):  # type: ignore[no-untyped-def]
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

        return int(by_bytes.address)

    @numba.cfunc("void(intp, intp, intp, intp, intp)", cache=True)  # type: ignore[untyped-decorator]
    def one_by_one(count, trees, tables, exits, sums):  # type: ignore[no-untyped-def]
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

    return int(one_by_one.address)

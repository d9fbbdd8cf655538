"""Sums the leaves that many rows reached, tree after tree, a row in every lane of a vector."""

from functools import cache
from typing import Final

import numba

from taxel_server.runtimes.trees.lookups import assemble, can_look_up, gather, lookup, register_bytes
from taxel_server.runtimes.trees.vectors import add, integer_at, load, load_floats, store

_SIGNATURE: Final = "void(intp, intp, intp, intp, intp, intp)"


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

    The function takes the number of trees, the addresses of the first LEAVES entry, the leaf
    tables, the block's exits and its sums, which start as the base score, and the number of rows.
    """
    part = min(lanes, 2 * register_bytes())
    return _add_looked_up(lanes, part) if can_look_up() else _add_gathered(lanes, part)


def _add_looked_up(lanes: int, part: int) -> int:
    @numba.cfunc(_SIGNATURE, cache=True)
    def add_trees(count, trees, tables, exits, sums, rows):  # type: ignore[no-untyped-def]
        for first in range(0, rows, part):
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
                elif kind == 0:
                    total = add(total, gather(table, places, 0, part))
                else:
                    total = add(total, gather(table, places, lanes, part))
            store(sums + 4 * first, total)

    return int(add_trees.address)


def _add_gathered(lanes: int, part: int) -> int:
    @numba.cfunc(_SIGNATURE, cache=True)
    def add_trees(count, trees, tables, exits, sums, rows):  # type: ignore[no-untyped-def]
        for first in range(0, rows, part):
            total = load_floats(sums + 4 * first, part)
            for tree in range(trees, trees + 16 * count, 16):
                table = tables + integer_at(tree, 64)
                places = exits + integer_at(tree + 8, 32) * lanes + first
                if integer_at(tree + 12, 32) == 0:
                    total = add(total, gather(table, places, 0, part))
                else:
                    total = add(total, gather(table, places, lanes, part))
            store(sums + 4 * first, total)

    return int(add_trees.address)

"""Sums the leaves that many rows reached, tree after tree. Every lane of a vector is a row."""

from functools import cache
from typing import Any

from taxel_server.runtimes.compiled.compiling import address_of, inlined
from taxel_server.runtimes.compiled.processor import register_bytes
from taxel_server.runtimes.compiled.vectors import FloatVector, add, integer_at, load, load_floats, store
from taxel_server.runtimes.trees.simd.lookups import assemble, can_look_up, gather, lookup


@inlined
def _leaves(planes: int, exits: int, size: int, lanes: int) -> Any:
    """The leaves at some exits. Each of their four bytes is looked up in a table of its own."""
    places = load(exits, 8, lanes)
    return assemble(
        lookup(planes, size, places),
        lookup(planes + size, size, places),
        lookup(planes + 2 * size, size, places),
        lookup(planes + 3 * size, size, places),
    )


@inlined
def _plus_gathered(total: FloatVector, kind: int, table: int, exits: int, upper: int, lanes: int) -> Any:
    """Adds the leaves of a tree whose table holds floats."""
    if kind == 0:
        return add(total, gather(table, exits, 0, lanes))
    return add(total, gather(table, exits, upper, lanes))


@inlined
def _plus_looked_up(total: FloatVector, kind: int, table: int, exits: int, upper: int, lanes: int) -> Any:
    """Adds the leaves of a tree with a table of any kind."""
    if kind == 1:
        return add(total, _leaves(table, exits, 16, lanes))
    if kind == 2:
        return add(total, _leaves(table, exits, 32, lanes))
    if kind == 3:
        return add(total, _leaves(table, exits, 48, lanes))
    if kind == 4:
        return add(total, _leaves(table, exits, 64, lanes))
    if kind == 8:
        return add(total, _leaves(table, exits, 128, lanes))
    return _plus_gathered(total, kind, table, exits, upper, lanes)


# This is chosen before anything is compiled: a look-up that the processor lacks does not compile.
_plus_leaves = _plus_looked_up if can_look_up() else _plus_gathered


@cache
def add_leaves(lanes: int) -> int:
    """Compiles the sum of one output's leaves, tree after tree; gives its address.

    The function takes:
        the number of trees
        the address of the first tree's entry, a LEAVES
        the address of the leaf tables
        the address of the block's exits
        the address of the block's sums, which start as the base score
        the number of rows
    """
    part = min(lanes, 2 * register_bytes())

    @address_of("void(intp, intp, intp, intp, intp, intp)")
    def add_trees(count: int, trees: int, tables: int, exits: int, sums: int, rows: int) -> None:
        for first in range(0, rows, part):
            total = load_floats(sums + 4 * first, part)
            for tree in range(trees, trees + 16 * count, 16):
                table = tables + integer_at(tree, 64)
                places = exits + integer_at(tree + 8, 32) * lanes + first
                total = _plus_leaves(total, integer_at(tree + 12, 32), table, places, lanes, part)
            store(sums + 4 * first, total)

    return add_trees

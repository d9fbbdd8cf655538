"""Evaluates few rows at once: every lane of a vector is a tree, and one row after another visits them."""

from functools import cache
from typing import Final

import numba

from taxel_server.runtimes.trees.lookups import lookup, register_bytes
from taxel_server.runtimes.trees.vectors import greater, load, prefetch, select, splat, store, unbias

_AHEAD: Final = 4096
"""Bytes by which the first row runs ahead of the nodes it asks for."""


def trees_at_once() -> int:
    """Trees of a group: four registers, so that four chains of dependent steps are in flight."""
    return 4 * register_bytes()


@cache
def find_exits(columns: int) -> int:
    """The address of the traversal of one group of trees by some rows, compiled.

    The function takes the address of the group's nodes (for every step its columns, limits and
    first leaves, a byte a tree each), the number of steps, the address of the ranks [row][column],
    the number of rows, and the address of the exits [row][tree], which it writes. `columns` is
    the length of a row's ranks: 16, 32, 48, 64, 128 or 256.
    """
    lanes = trees_at_once()

    @numba.cfunc("void(intp, intp, intp, intp, intp)", cache=True)
    def traverse(nodes, steps, ranks, rows, exits):  # type: ignore[no-untyped-def]
        for row in range(rows):
            table = ranks + row * columns
            node = nodes
            reached = splat(-128, 8, lanes)
            for step in range(1, steps + 1):
                rank = lookup(table, columns, load(node, 8, lanes))
                goes_left = greater(load(node + lanes, 8, lanes), rank)
                first = select(goes_left, splat(-1, 8, lanes), load(node + 2 * lanes, 8, lanes))
                if row == 0:
                    for line in range(0, 3 * lanes, 64):
                        prefetch(node + _AHEAD + line)
                reached = select(greater(first, reached), reached, splat(step - 128, 8, lanes))
                node += 3 * lanes
            store(exits + row * lanes, unbias(reached))

    return int(traverse.address)

"""Leaf values in memory as the sum of many rows looks them up."""

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.in_order import InOrder
from taxel_server.runtimes.trees.lookups import can_look_up

LEAVES: Final = np.dtype([("table", "<i8"), ("exits", "<i4"), ("kind", "<i4")])
"""Of a tree: its leaf table's first byte, its exits' place, and the table's kind.

Kinds above 0 are byte tables: so many times 16 leaves, all their lowest bytes first. Kind 0 are
floats found with 8-bit exits, -1 floats found with 16-bit exits.
"""

_ALIGNMENT: Final = 64


def write_leaf_tables(
    index: InOrder, order: NDArray[np.int64], small: NDArray[np.bool_], leaves: NDArray[np.void]
) -> NDArray[np.uint8]:
    """Writes the leaf tables, and their place and kind into `leaves`."""
    counts = index.leaves[order]
    sixteens = -(-counts // 16)
    kinds = np.where(sixteens > 4, 8, sixteens) if can_look_up() else np.zeros_like(counts)
    leaves["kind"] = np.where(small, kinds, -1)
    sizes = np.where(leaves["kind"] > 0, 64 * leaves["kind"], 4 * counts)
    sizes = -(-sizes // _ALIGNMENT) * _ALIGNMENT
    leaves["table"] = np.cumsum(sizes) - sizes
    tables = np.zeros(int(sizes.sum()), dtype=np.uint8)
    _write_tables(
        index.leaf_start[order],
        counts,
        leaves["table"].copy(),
        leaves["kind"].copy(),
        index.value.view(np.uint8),
        tables,
    )
    return tables


@numba.njit(cache=True, nogil=True)
def _write_tables(starts, counts, places, kinds, values, tables):  # type: ignore[no-untyped-def]
    for tree in range(starts.size):
        plane, step = (16 * kinds[tree], 1) if kinds[tree] > 0 else (1, 4)
        for leaf in range(counts[tree]):
            for byte in range(4):
                tables[places[tree] + byte * plane + leaf * step] = values[4 * (starts[tree] + leaf) + byte]

"""Leaf values in memory as the sum of many rows looks them up."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.layout.bitsets import LeafNumbers
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.simd.lookups import can_look_up

LEAVES: Final = np.dtype([("table", "<i8"), ("exits", "<i4"), ("kind", "<i4")])
"""Of a tree: its leaf table's first byte, its exits' place, and the table's kind.

Kinds above 0 are byte tables: so many times 16 leaves, all their lowest bytes first. Kind 0 are
floats found with exits of one byte, -1 floats found with exits of two.
"""

_ALIGNMENT: Final = 64


def write_leaf_tables(
    index: InOrder,
    numbers: LeafNumbers,
    order: NDArray[np.int64],
    leaves: NDArray[np.void],
    byte_tables: bool,
) -> NDArray[np.uint8]:
    """Writes the leaf tables by leaf number, and their place and kind into `leaves`.

    Those of floats take less room; bytes are looked up faster, where the processor can.
    """
    counts = numbers.count[order]
    sixteens = -(-counts // 16)
    kinds = (
        np.select([sixteens <= 4, sixteens <= 8], [sixteens, 8], 0)
        if byte_tables and can_look_up()
        else np.zeros_like(counts)
    )
    leaves["kind"] = np.where(numbers.small[order], kinds, -1)
    sizes = np.where(leaves["kind"] > 0, 64 * leaves["kind"], 4 * counts)
    sizes = -(-sizes // _ALIGNMENT) * _ALIGNMENT
    leaves["table"] = np.cumsum(sizes) - sizes
    tables = np.zeros(int(sizes.sum()), dtype=np.uint8)
    _write_tables(
        index.leaf_start[order],
        index.leaves[order],
        leaves["table"].copy(),
        leaves["kind"].copy(),
        numbers.number,
        index.value.view(np.uint8),
        tables,
    )
    return tables


@compiled
def _write_tables(
    starts: NDArray[np.int64],
    counts: NDArray[np.int64],
    places: NDArray[np.int64],
    kinds: NDArray[np.int32],
    numbers: NDArray[np.int32],
    values: NDArray[np.uint8],
    tables: NDArray[np.uint8],
) -> None:
    for tree in range(starts.size):
        plane, step = (16 * kinds[tree], 1) if kinds[tree] > 0 else (1, 4)
        for leaf in range(starts[tree], starts[tree] + counts[tree]):
            for byte in range(4):
                tables[places[tree] + byte * plane + numbers[leaf] * step] = values[4 * leaf + byte]

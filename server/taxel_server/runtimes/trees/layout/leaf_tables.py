"""Tables of leaf values, in which the evaluators of many rows look leaves up."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.layout.bitsets import LeafNumbers
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.simd.lookups import can_look_up

LEAVES: Final = np.dtype([("table", "<i8"), ("exits", "<i4"), ("kind", "<i4")])
"""A tree's entry: the first byte of its leaf table, the place of its exits, and the kind of the table.

A kind k above 0 is a byte table for 16 k leaves: first the lowest byte of every leaf, then the next. Kind 0
is a table of floats for exits of one byte, and kind -1 for exits of two bytes.
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

    Tables of floats take less memory. Byte tables are faster if the processor has byte shuffles.
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

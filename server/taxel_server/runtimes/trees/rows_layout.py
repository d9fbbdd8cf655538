"""The forest as the kernels that hold rows in lanes read it."""

from dataclasses import dataclass
from typing import Final, Self

import numba
import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.columns import Columns
from taxel_server.runtimes.trees.in_order import InOrder

INTERLEAVED: Final = 4
"""Trees whose nodes alternate in memory, so that a kernel can keep as many steps in flight."""

MOST_LEAVES: Final = {8: 127, 16: 32767}
"""Leaves of the largest tree whose exits fit, for exits of so many bits."""

_RECORDS: Final = {
    8: np.dtype([("column", "<u2"), ("limit", "i1"), ("first", "i1")]),
    16: np.dtype([("column", "<u2"), ("limit", "<i2"), ("first", "<i2"), ("unused", "<u2")]),
}

GROUP: Final = np.dtype([("nodes", "<i8"), ("steps", "<i8"), ("trees", "<i8", INTERLEAVED)])
"""First record of a group, its steps, and its trees' places among those of their output."""


@dataclass(frozen=True)
class RowsLayout:
    """Trees of like size in groups, output by output.

    Attributes:
        columns: how rows are ranked for these trees.
        groups: (groups,) GROUP.
        start: (outputs + 1,) int64, each output's first group.
        records: (records,) nodes; the steps of a group's trees alternate.
    """

    columns: Columns
    groups: NDArray[np.void]
    start: NDArray[np.int64]
    records: NDArray[np.void]

    @classmethod
    def of(
        cls,
        index: InOrder,
        bits: int,
        trees: NDArray[np.int64],
        outputs: NDArray[np.int32],
        places: NDArray[np.int64],
        spare: int,
        targets: int,
    ) -> Self:
        """Lays out some trees of a forest.

        Args:
            index: the forest.
            bits: size of ranks and exits.
            trees: which trees.
            outputs: (all trees,) the output that each adds to.
            places: (all trees,) its place among that output's trees.
            spare: the place named where a group is not full.
            targets: number of outputs.
        """
        columns = Columns.of(index, bits, trees)
        order = trees[np.lexsort((index.leaves[trees], outputs[trees]))]
        count = np.bincount(outputs[trees], minlength=targets)
        width = -(-count // INTERLEAVED)
        start = np.concatenate([[0], np.cumsum(width)])
        # Where each tree stands in groups that each output fills from its first group on.
        before = np.repeat(start[:-1] * INTERLEAVED - (np.cumsum(count) - count), count)
        seats = np.arange(len(order)) + before
        members = np.full(start[-1] * INTERLEAVED, -1, dtype=np.int64)
        members[seats] = order
        members = members.reshape(-1, INTERLEAVED)
        steps = np.where(members >= 0, index.leaves[members] - 1, 0).max(axis=1, initial=0)
        groups = np.empty(len(members), dtype=GROUP)
        groups["nodes"] = np.cumsum(steps * INTERLEAVED) - steps * INTERLEAVED
        groups["steps"] = steps
        groups["trees"] = np.where(members >= 0, places[members], spare)
        records = np.zeros(int(steps.sum()) * INTERLEAVED, dtype=_RECORDS[bits])
        records["first"] = -1
        seat = np.empty(int(np.maximum(index.leaves[order] - 1, 0).sum()), dtype=np.int64)
        source = np.empty_like(seat)
        _place(members, groups["nodes"].copy(), index.leaves, index.node_start, seat, source)
        records["column"][seat] = columns.column[source]
        records["limit"][seat] = columns.limit[source]
        records["first"][seat] = index.first[source] - 2 ** (bits - 1)
        return cls(columns, groups, start, records)


@numba.njit(cache=True, nogil=True)
def _place(members, group_nodes, leaves, node_start, seat, source):  # type: ignore[no-untyped-def]
    """The record of every inner node, and which node it is."""
    count = 0
    for group in range(members.shape[0]):
        for member in range(members.shape[1]):
            tree = members[group, member]
            if tree < 0:
                continue
            for step in range(leaves[tree] - 1):
                seat[count] = group_nodes[group] + step * members.shape[1] + member
                source[count] = node_start[tree] + step
                count += 1

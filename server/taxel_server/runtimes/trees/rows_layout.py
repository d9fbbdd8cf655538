"""The forest as the kernels that hold sets of rows read it."""

from dataclasses import dataclass
from typing import Final, Self

import numba
import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.columns import Columns
from taxel_server.runtimes.trees.in_order import InOrder

TOGETHER: Final = 4
"""Trees whose nodes alternate in memory, so that a kernel can keep as many steps in flight."""

MOST_LEAVES: Final = {1: 256, 2: 65536}
"""Leaves of the largest tree whose leaf numbers take so many bytes."""

SET_BYTES: Final = 32
"""How far one leaf's set of rows is from the next's in a kernel's memory."""

RECORDS: Final = {
    1: np.dtype([("comparison", "<u2"), ("leaf", "<u2")]),
    2: np.dtype([("comparison", "<u4"), ("leaf", "<u4")]),
}
"""An inner node: what it compares, and where the set is of the first leaf below it, in bytes."""

GROUP: Final = np.dtype(
    [("nodes", "<i8"), ("steps", "<i8"), ("sixteens", "<i8"), ("trees", "<i8", TOGETHER)]
)
"""First record of a group, its steps, its leaves in sixteens, its trees' places among their output's."""


@dataclass(frozen=True)
class RowsLayout:
    """Trees of like size in groups, output by output, the smallest first.

    Attributes:
        size: bytes of a leaf's number.
        groups: (groups,) GROUP.
        start: (outputs + 1,) int64, each output's first group.
        records: (records,) nodes by `leaf_numbers`; the steps of a group's trees alternate.
    """

    size: int
    groups: NDArray[np.void]
    start: NDArray[np.int64]
    records: NDArray[np.void]

    @classmethod
    def of(
        cls,
        index: InOrder,
        numbers: NDArray[np.int32],
        columns: Columns,
        size: int,
        trees: NDArray[np.int64],
        outputs: NDArray[np.int32],
        places: NDArray[np.int64],
        spare: int,
        targets: int,
    ) -> Self:
        """Lays out some trees of a forest.

        Args:
            index: the forest.
            numbers: (all leaves,) from `leaf_numbers`.
            columns: its comparisons.
            size: bytes of a leaf's number.
            trees: which trees.
            outputs: (all trees,) the output that each adds to.
            places: (all trees,) its place among that output's trees.
            spare: the place named where a group is not full.
            targets: number of outputs.
        """
        order = trees[np.lexsort((index.leaves[trees], outputs[trees]))]
        count = np.bincount(outputs[trees], minlength=targets)
        width = -(-count // TOGETHER)
        start = np.concatenate([[0], np.cumsum(width)])
        # Where each tree stands in groups that each output fills from its first group on.
        before = np.repeat(start[:-1] * TOGETHER - (np.cumsum(count) - count), count)
        members = np.full(start[-1] * TOGETHER, -1, dtype=np.int64)
        members[np.arange(len(order)) + before] = order
        members = members.reshape(-1, TOGETHER)
        leaves = np.where(members >= 0, index.leaves[members], 1).max(axis=1, initial=1)
        groups = np.empty(len(members), dtype=GROUP)
        groups["nodes"] = np.cumsum((leaves - 1) * TOGETHER) - (leaves - 1) * TOGETHER
        groups["steps"] = leaves - 1
        groups["sixteens"] = -(-leaves // 16)
        groups["trees"] = np.where(members >= 0, places[members], spare)
        records = np.empty(int((leaves - 1).sum()) * TOGETHER, dtype=RECORDS[size])
        # What fills a group up splits the set behind its sixteens, which is empty.
        records["comparison"] = 0
        records["leaf"] = np.repeat(16 * SET_BYTES * groups["sixteens"], (leaves - 1) * TOGETHER)
        seat = np.empty(int((index.leaves[order] - 1).sum()), dtype=np.int64)
        source, leaf = np.empty_like(seat), np.empty_like(seat)
        _place(
            members,
            groups["nodes"].copy(),
            index.leaves,
            index.node_start,
            index.leaf_start,
            index.first,
            numbers,
            seat,
            source,
            leaf,
        )
        records["comparison"][seat] = columns.comparison[source]
        records["leaf"][seat] = leaf * SET_BYTES
        return cls(size, groups, start, records)


def leaf_numbers(index: InOrder) -> NDArray[np.int32]:
    """(leaves,) Each leaf's number within its tree, as the splits from the root downwards hand them out.

    All rows start at the first leaf, number 0. A node's left child keeps its leaf; its right child's
    first leaf is new, and takes the next number.
    """
    numbers = np.empty(len(index.value), dtype=np.int32)
    _number_leaves(index.leaves, index.node_start, index.leaf_start, index.depth, numbers)
    return numbers


@numba.njit(cache=True, nogil=True)
def _number_leaves(leaves, node_start, leaf_start, depth, numbers):  # type: ignore[no-untyped-def]
    """Level by level; between inner nodes i - 1 and i lies leaf i, the first right of node i - 1."""
    before = np.empty((depth.max() if depth.size else 0) + 2, dtype=np.int32)
    for tree in range(leaves.size):
        start, inner = node_start[tree], leaves[tree] - 1
        before[:] = 0
        for node in range(start, start + inner):
            before[depth[node] + 1] += 1
        for level in range(1, before.size):
            before[level] += before[level - 1]
        numbers[leaf_start[tree]] = 0
        for step in range(inner):
            level = depth[start + step]
            before[level] += 1
            numbers[leaf_start[tree] + step + 1] = before[level]


@numba.njit(cache=True, nogil=True)
def _place(members, group_nodes, leaves, node_start, leaf_start, first, numbers, seat, source, leaf):  # type: ignore[no-untyped-def]
    """The record of every inner node, which node it is, and the number of the first leaf below it."""
    count = 0
    for group in range(members.shape[0]):
        for member in range(members.shape[1]):
            tree = members[group, member]
            if tree < 0:
                continue
            for step in range(leaves[tree] - 1):
                place = numbers[leaf_start[tree] + step + 1] - 1
                node = node_start[tree] + step
                seat[count] = group_nodes[group] + place * members.shape[1] + member
                source[count] = node
                leaf[count] = numbers[leaf_start[tree] + first[node]]
                count += 1

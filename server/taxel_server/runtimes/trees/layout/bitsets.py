"""The layout for the bitset traversal.

A tree's upper levels are laid out as if they were full. So a node's place tells which set of rows it
splits, and eight trees take a step together. At a place without a node, no row goes right. Each node of the
lower levels names the set that it splits.
"""

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.layout.columns import Columns
from taxel_server.runtimes.trees.layout.in_order import InOrder

MOST_LEAVES: Final = {1: 256, 2: 65536}
"""The most leaves of a tree, by the bytes of its leaf numbers."""

TOGETHER: Final = {1: 8, 2: 4}
"""Trees of a group, by the bytes of leaf numbers. Their nodes alternate in memory, and their sets fit the
first-level cache."""

SET_BYTES: Final = 32
"""The unit of a set's place in a node's record."""

RECORDS: Final = {
    1: np.dtype([("comparison", "<u2"), ("leaf", "<u2")]),
    2: np.dtype([("comparison", "<u4"), ("leaf", "<u4")]),
}
"""An inner node: the number of its comparison, and the place of the set of its first leaf, in bytes."""

GROUP: Final = np.dtype(
    [("records", "<i8"), ("steps", "<i8"), ("sixteens", "<i8"), ("trees", "<i8", TOGETHER[1])]
)
"""A group: the first byte of its records, its steps, a sixteenth of its leaf numbers, its trees' places.

The records begin with one comparison for each place of the upper levels. One node for each step follows.
The trees of a group alternate.
"""

_MOST_UPPER: Final = 6
"""The most levels that are laid out as if they were full."""

_OCCUPIED: Final = 0.4
"""The least share of an upper level's places that have a node. With fewer nodes, the level costs time."""


@dataclass(frozen=True)
class LeafNumbers:
    """Each leaf's number within its tree. The splits number the leaves from the root downwards.

    All rows start in set 0, the set of the first leaf. At a split, the left child keeps the set's number,
    and the first leaf of the right child gets the next number.

    Attributes:
        upper: how many upper levels of small trees are laid out as if they were full.
        small: (trees,) bool, whether a tree's numbers take one byte.
        number: (leaves,) int32.
        count: (trees,) int64, how many numbers a tree has.
    """

    upper: int
    small: NDArray[np.bool_]
    number: NDArray[np.int32]
    count: NDArray[np.int64]

    @classmethod
    def of(cls, index: InOrder, narrow: bool, upper_levels: bool) -> Self:
        """Numbers all leaves.

        Args:
            index: the forest.
            narrow: whether trees may be small.
            upper_levels: whether upper levels may be laid out as if they were full.
        """
        number = np.empty(len(index.value), dtype=np.int32)
        count = np.empty_like(index.leaves)
        small = np.logical_and(index.leaves <= MOST_LEAVES[1], narrow)
        # With few nodes in the upper levels, a tree may need more numbers than it has leaves. If they are
        # too many, no level is laid out as if it were full.
        for upper in (_upper_levels(index, small) if upper_levels else 0, 0):
            _number(
                index.leaves,
                index.node_start,
                index.leaf_start,
                index.depth,
                index.place,
                small,
                upper,
                number,
                count,
            )
            if count[small].max(initial=0) <= MOST_LEAVES[1]:
                break
        return cls(upper, small, number, count)


@dataclass(frozen=True)
class BitsetTrees:
    """Trees in groups, output by output, the smallest first.

    Attributes:
        size: the bytes of a leaf number.
        upper: how many levels are laid out as if they were full.
        groups: (groups,) GROUP.
        start: (outputs + 1,) int64, each output's first group.
        records: (bytes,) uint8.
    """

    size: int
    upper: int
    groups: NDArray[np.void]
    start: NDArray[np.int64]
    records: NDArray[np.uint8]

    @classmethod
    def of(
        cls,
        index: InOrder,
        numbers: LeafNumbers,
        columns: Columns,
        size: int,
        outputs: NDArray[np.int32],
        places: NDArray[np.int64],
        spare: int,
        targets: int,
    ) -> Self:
        """Lays out the trees whose leaf numbers take `size` bytes.

        Args:
            index: the forest.
            numbers: its leaf numbers.
            columns: its comparisons; the one behind the last is true for no row.
            size: the bytes of a leaf number.
            outputs: (trees,) the output that each tree adds to.
            places: (trees,) each tree's place among the trees of its output.
            spare: the place for a group's missing trees.
            targets: the number of outputs.
        """
        trees = np.flatnonzero(numbers.small if size == 1 else ~numbers.small)
        upper = numbers.upper if size == 1 else 0
        together = TOGETHER[size]
        order = trees[np.lexsort((numbers.count[trees], outputs[trees]))]
        count = np.bincount(outputs[trees], minlength=targets)
        width = -(-count // together)
        start = np.concatenate([[0], np.cumsum(width)])
        # How far a tree moves, since each output begins with a new group.
        before = np.repeat(start[:-1] * together - (np.cumsum(count) - count), count)
        members = np.full(start[-1] * together, -1, dtype=np.int64)
        members[np.arange(len(order)) + before] = order
        members = members.reshape(-1, together)
        most = np.where(members >= 0, numbers.count[members], 2**upper).max(axis=1, initial=2**upper)
        groups = np.zeros(len(members), dtype=GROUP)
        groups["steps"] = most - 2**upper
        groups["sixteens"] = -(-most // 16)
        groups["trees"][:, :together] = np.where(members >= 0, places[members], spare)
        record = RECORDS[size]
        bytes_upper = (2**upper - 1) * together * record["comparison"].itemsize
        room = bytes_upper + groups["steps"] * together * record.itemsize
        groups["records"] = np.cumsum(room) - room
        entries = np.zeros(int(room.sum()) // record["comparison"].itemsize, dtype=record["comparison"])
        _place(
            members,
            groups["records"] // record["comparison"].itemsize,
            groups["steps"].copy(),
            upper,
            len(columns.cuts.cuts),
            index.leaves,
            index.node_start,
            index.leaf_start,
            index.first,
            index.depth,
            index.place,
            columns.comparison,
            numbers.number,
            entries,
        )
        return cls(size, upper, groups, start, entries.view(np.uint8))


def split_sets(upper: int) -> NDArray[np.int64]:
    """(2**upper - 1,) The set that the node at each place of the upper levels splits, in bytes."""
    sets = [0]
    for place in range(1, 2**upper - 1):
        parent = (place - 1) // 2
        # A left child splits the set of its parent, a right child the set that its parent's split made.
        sets.append(sets[parent] if place % 2 else parent + 1)
    return np.array(sets[: 2**upper - 1], dtype=np.int64) * SET_BYTES


def _upper_levels(index: InOrder, small: NDArray[np.bool_]) -> int:
    """How many levels of the small trees have enough nodes to be laid out as if they were full."""
    depth = index.depth[np.repeat(small, index.leaves - 1)]
    nodes = np.bincount(depth[depth < _MOST_UPPER], minlength=_MOST_UPPER)
    places = max(1, int(small.sum())) * 2 ** np.arange(_MOST_UPPER)
    return int(np.argmax(np.append(nodes / places, 0.0) < _OCCUPIED))


@compiled
def _number(
    leaves: NDArray[np.int64],
    node_start: NDArray[np.int64],
    leaf_start: NDArray[np.int64],
    depth: NDArray[np.int32],
    place: NDArray[np.int32],
    small: NDArray[np.bool_],
    upper: int,
    number: NDArray[np.int32],
    count: NDArray[np.int64],
) -> None:
    """Numbers leaves level by level. Leaf i stands between inner nodes i - 1 and i, right of node i - 1."""
    before = np.empty((depth.max() if depth.size else 0) + 2, dtype=np.int32)
    for tree in range(leaves.size):
        start, inner = node_start[tree], leaves[tree] - 1
        levels = upper if small[tree] else 0
        before[:] = 0
        for node in range(start, start + inner):
            if depth[node] >= levels:
                before[depth[node] + 1] += 1
        before[levels] = 1 << levels
        for level in range(levels + 1, before.size):
            before[level] += before[level - 1]
        number[leaf_start[tree]] = 0
        for step in range(inner):
            level, leaf = depth[start + step], leaf_start[tree] + step + 1
            if level < levels:
                number[leaf] = (1 << level) + place[start + step]
            else:
                number[leaf] = before[level]
                before[level] += 1
        count[tree] = before[before.size - 1]


@compiled
def _place(
    members: NDArray[np.int64],
    records: NDArray[np.int64],
    steps: NDArray[np.int64],
    upper: int,
    never: int,
    leaves: NDArray[np.int64],
    node_start: NDArray[np.int64],
    leaf_start: NDArray[np.int64],
    first: NDArray[np.int32],
    depth: NDArray[np.int32],
    place: NDArray[np.int32],
    comparison: NDArray[np.int64],
    number: NDArray[np.int32],
    entries: NDArray[Any],
) -> None:
    """Writes every node to its place in its group. At a place without a node, no row goes right."""
    together = members.shape[1]
    below = ((1 << upper) - 1) * together
    for group in range(members.shape[0]):
        start = records[group]
        entries[start : start + below] = never
        for step in range(steps[group] * together):
            entries[start + below + 2 * step] = never
        for member in range(together):
            tree = members[group, member]
            if tree < 0:
                continue
            for step in range(leaves[tree] - 1):
                node = node_start[tree] + step
                if depth[node] < upper:
                    across = (1 << depth[node]) - 1 + place[node]
                    entries[start + across * together + member] = comparison[node]
                else:
                    row = number[leaf_start[tree] + step + 1] - (1 << upper)
                    at = start + below + 2 * (row * together + member)
                    entries[at] = comparison[node]
                    entries[at + 1] = number[leaf_start[tree] + first[node]] * SET_BYTES

"""The in-order index: a forest whose trees need neither child pointers nor branches.

Number a tree's leaves from left to right. An inner node then lies between the last leaf of its left
subtree and the first leaf of its right one: node i between leaves i and i + 1. Call the first leaf
of its left subtree `first`. The leaf that a row reaches is found by looking at every node once:

    exit = 0
    for node in range(leaves - 1):
        if goes_right[node] and exit >= first[node]:
            exit = node + 1

Why this is right: `exit` is the first leaf of the subtree that the row has reached by the nodes seen so
far. A node on the row's path has exit == first at its turn: all right turns above it stand earlier in
order. A node off the path is in a subtree that the row left. If the row left it by a left turn, all nodes
of the subtree have first > exit, and change nothing. If the row left it by a right turn, the subtree's
nodes stand before the node of that turn in order, and that node then overwrites `exit` with a larger leaf.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.reading.forest import LEAF, Forest


@dataclass(frozen=True)
class InOrder:
    """Inner nodes and leaves of all trees, each in order.

    Attributes:
        leaves: (trees,) int64, leaves of each tree; it has one inner node less.
        node_start: (trees,) int64, place of each tree's first inner node.
        leaf_start: (trees,) int64, place of each tree's first leaf.
        first: (inner nodes,) int32, first leaf of the left subtree, counted within the tree.
        last: (inner nodes,) int32, last leaf of the right subtree, counted within the tree.
        depth: (inner nodes,) int32, 0 for a tree's root.
        place: (inner nodes,) int32, the node's place in its level from left to right, counted as if the
            level were full; below level 30 it has no meaning.
        feature: (inner nodes,) int32.
        default_left: (inner nodes,) bool.
        threshold: (inner nodes,) float32.
        value: (leaves,) float32.
    """

    leaves: NDArray[np.int64]
    node_start: NDArray[np.int64]
    leaf_start: NDArray[np.int64]
    first: NDArray[np.int32]
    last: NDArray[np.int32]
    depth: NDArray[np.int32]
    place: NDArray[np.int32]
    feature: NDArray[np.int32]
    default_left: NDArray[np.bool_]
    threshold: NDArray[np.float32]
    value: NDArray[np.float32]

    @classmethod
    def of(cls, forest: Forest) -> Self:
        """Renumbers a forest in preorder."""
        nodes = np.diff(forest.roots)
        leaves = (nodes + 1) // 2
        inner = int(nodes.sum() - leaves.sum())
        index = cls(
            leaves=leaves,
            node_start=np.cumsum(leaves - 1) - (leaves - 1),
            leaf_start=np.cumsum(leaves) - leaves,
            first=np.empty(inner, dtype=np.int32),
            last=np.empty(inner, dtype=np.int32),
            depth=np.empty(inner, dtype=np.int32),
            place=np.empty(inner, dtype=np.int32),
            feature=np.empty(inner, dtype=np.int32),
            default_left=np.empty(inner, dtype=np.bool_),
            threshold=np.empty(inner, dtype=np.float32),
            value=np.empty(int(leaves.sum()), dtype=np.float32),
        )
        source = np.empty(inner, dtype=np.int64)
        _renumber(
            forest.roots,
            forest.right,
            forest.value,
            index.node_start,
            index.leaf_start,
            index.first,
            index.last,
            index.depth,
            index.place,
            source,
            index.value,
        )
        index.feature[:] = forest.feature[source]
        index.default_left[:] = forest.default_left[source]
        index.threshold[:] = forest.value[source]
        return index


@compiled
def _renumber(
    roots: NDArray[np.int64],
    right: NDArray[np.int32],
    value: NDArray[np.float32],
    node_start: NDArray[np.int64],
    leaf_start: NDArray[np.int64],
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    depth: NDArray[np.int32],
    place: NDArray[np.int32],
    source: NDArray[np.int64],
    leaf_value: NDArray[np.float32],
) -> None:
    leaves = np.empty(right.size, dtype=np.int32)
    lowest = np.empty(right.size, dtype=np.int32)
    level, across = np.empty(right.size, dtype=np.int32), np.empty(right.size, dtype=np.int32)
    for tree in range(roots.size - 1):
        root = roots[tree]
        for node in range(roots[tree + 1] - 1, root - 1, -1):
            if right[node] == LEAF:
                leaves[node] = 1
            else:
                leaves[node] = leaves[node + 1] + leaves[root + right[node]]
        lowest[root], level[root], across[root] = 0, 0, 0
        for node in range(root, roots[tree + 1]):
            if right[node] == LEAF:
                leaf_value[leaf_start[tree] + lowest[node]] = value[node]
                continue
            low, high = node + 1, root + right[node]
            lowest[low] = lowest[node]
            lowest[high] = lowest[node] + leaves[low]
            level[low] = level[high] = level[node] + 1
            across[low], across[high] = 2 * across[node], 2 * across[node] + 1
            inner = node_start[tree] + lowest[high] - 1
            first[inner], last[inner] = lowest[node], lowest[node] + leaves[node] - 1
            depth[inner], place[inner] = level[node], across[node]
            source[inner] = node

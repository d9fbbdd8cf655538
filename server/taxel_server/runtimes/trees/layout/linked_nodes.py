"""A forest as nodes that name their children, for trees too large to look at every node of."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.layout.columns import Columns
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.reading.forest import LEAF, Forest

LINKED_NODE: Final = np.dtype([("column", "<u2"), ("limit", "<u2"), ("left", "<i4")])
"""A node; its right child follows its left one, and a leaf is its own left child.

Limits are not biased here.
"""


@dataclass(frozen=True)
class LinkedLayout:
    """Trees as nodes that name their children; a row's ranks take two bytes.

    Attributes:
        columns: how rows are ranked; one more column holds the lowest rank.
        nodes: (nodes,) LINKED_NODE, tree after tree as in the forest.
        value: (nodes,) float32, meant for leaves.
    """

    columns: Columns
    nodes: NDArray[np.void]
    value: NDArray[np.float32]

    @classmethod
    def of(cls, forest: Forest, index: InOrder) -> Self:
        """Links a forest's nodes, in breadth-first order so that siblings are neighbours."""
        columns = Columns.of(index, 16, np.arange(forest.trees))
        nodes = np.empty(forest.nodes, dtype=LINKED_NODE)
        source, inner = np.empty(forest.nodes, dtype=np.int64), np.empty(forest.nodes, dtype=np.int64)
        left = np.empty(forest.nodes, dtype=np.int32)
        _link(forest.roots, forest.left, forest.right, index.node_start, source, inner, left)
        is_inner = inner >= 0
        nodes["left"] = left
        nodes["column"] = np.where(is_inner, columns.column[inner] if len(columns) else 0, len(columns))
        limit = columns.limit[inner].astype(np.int32) + 32768 if len(columns) else 0
        nodes["limit"] = np.where(is_inner, limit, 65535)
        return cls(columns, nodes, forest.value[source])


@compiled
def _link(roots, left, right, node_start, source, inner, new_left):  # type: ignore[no-untyped-def]
    """Orders the nodes of each tree breadth first; names of inner nodes are their in-order ones."""
    leaves = np.empty(left.size, dtype=np.int32)
    lowest = np.empty(left.size, dtype=np.int32)
    for tree in range(roots.size - 1):
        root, stop = roots[tree], roots[tree + 1]
        for node in range(stop - 1, root - 1, -1):
            is_leaf = left[node] == LEAF
            leaves[node] = 1 if is_leaf else leaves[root + left[node]] + leaves[root + right[node]]
        lowest[root] = 0
        source[root] = root
        filled = root + 1
        for new in range(root, stop):
            node = source[new]
            if left[node] == LEAF:
                new_left[new], inner[new] = new, -1
                continue
            low, high = root + left[node], root + right[node]
            lowest[low], lowest[high] = lowest[node], lowest[node] + leaves[low]
            inner[new] = node_start[tree] + lowest[high] - 1
            new_left[new] = filled
            source[filled], source[filled + 1] = low, high
            filled += 2

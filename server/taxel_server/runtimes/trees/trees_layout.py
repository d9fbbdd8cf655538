"""The forest as the kernels for few rows read it: small trees side by side, large ones as linked nodes."""

from dataclasses import dataclass
from typing import Final, Self

import numba
import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.columns import Columns
from taxel_server.runtimes.trees.forest import LEAF, Forest
from taxel_server.runtimes.trees.in_order import InOrder

TABLE_SIZES: Final = (16, 32, 48, 64, 128, 256)
"""How many columns a row's byte ranks may have, padded."""

LINKED_NODE: Final = np.dtype([("column", "<u2"), ("limit", "<u2"), ("left", "<i4")])
"""A node of a large tree; its right child follows its left one, and a leaf is its own left child.

Limits are not biased here.
"""


@dataclass(frozen=True)
class SideBySide:
    """Trees of like size in groups, the nodes of a group step by step.

    Attributes:
        columns: how rows are ranked for these trees.
        size: a row's ranks, padded: one of TABLE_SIZES.
        steps: (groups,) int64.
        start: (groups + 1,) int64, each group's first byte in `nodes`.
        nodes: (bytes,) uint8.
        tree: (groups, lanes) int64, the tree of every lane, or -1.
        leaf_start: (groups,) int64, each group's first entry in `value`.
        value: (floats,) float32, the leaves: steps + 1 for every lane of a group.
    """

    columns: Columns
    size: int
    steps: NDArray[np.int64]
    start: NDArray[np.int64]
    nodes: NDArray[np.uint8]
    tree: NDArray[np.int64]
    leaf_start: NDArray[np.int64]
    value: NDArray[np.float32]

    @classmethod
    def of(cls, index: InOrder, columns: Columns, trees: NDArray[np.int64], lanes: int) -> Self:
        """Sorts trees by size into groups."""
        order = trees[np.argsort(index.leaves[trees], kind="stable")]
        seats = np.full(-(-len(order) // lanes) * lanes, -1, dtype=np.int64)
        seats[: len(order)] = order
        tree = seats.reshape(-1, lanes)
        steps = np.where(tree >= 0, index.leaves[tree] - 1, 0).max(axis=1, initial=0)
        start = np.concatenate([[0], np.cumsum(3 * lanes * steps)])
        nodes = np.zeros(start[-1], dtype=np.uint8)
        _put_side_by_side(
            tree,
            steps,
            start,
            index.leaves,
            index.node_start,
            columns.column,
            columns.limit,
            index.first,
            nodes,
        )
        room = lanes * (steps + 1)
        leaf_start = np.cumsum(room) - room
        value = np.zeros(int(room.sum()), dtype=np.float32)
        _put_leaves(tree, steps, leaf_start, index.leaves, index.leaf_start, index.value, value)
        size = next(size for size in TABLE_SIZES if size >= len(columns))
        return cls(columns, size, steps, start, nodes, tree, leaf_start, value)


@dataclass(frozen=True)
class Linked:
    """Trees as nodes that name their children.

    Attributes:
        columns: how rows are ranked for these trees; one more column holds the lowest rank.
        root: (trees,) int64, each tree's first node.
        nodes: (nodes,) LINKED_NODE.
        value: (nodes,) float32, meant for leaves.
        tree: (trees,) int64, which trees.
    """

    columns: Columns
    root: NDArray[np.int64]
    nodes: NDArray[np.void]
    value: NDArray[np.float32]
    tree: NDArray[np.int64]

    @classmethod
    def of(cls, forest: Forest, index: InOrder, columns: Columns, trees: NDArray[np.int64]) -> Self:
        """Links trees, their nodes in breadth-first order so that siblings are neighbours."""
        counts = 2 * index.leaves[trees] - 1
        root = np.cumsum(counts) - counts
        nodes = np.empty(int(counts.sum()), dtype=LINKED_NODE)
        source = np.empty(len(nodes), dtype=np.int64)
        inner = np.empty(len(nodes), dtype=np.int64)
        left = np.empty(len(nodes), dtype=np.int32)
        _link(trees, forest.roots, forest.left, forest.right, index.node_start, root, source, inner, left)
        is_inner = inner >= 0
        nodes["left"] = left
        nodes["column"] = np.where(is_inner, columns.column[inner] if len(columns) else 0, len(columns))
        limit = columns.limit[inner].astype(np.int32) + 32768 if len(columns) else 0
        nodes["limit"] = np.where(is_inner, limit, 65535)
        return cls(columns, root, nodes, forest.value[source], trees)


@numba.njit(cache=True, nogil=True)
def _put_side_by_side(tree, steps, start, leaves, node_start, column, limit, first, nodes):  # type: ignore[no-untyped-def]
    lanes = tree.shape[1]
    for group in range(tree.shape[0]):
        for step in range(steps[group]):
            place = start[group] + 3 * lanes * step
            for lane in range(lanes):
                member = tree[group, lane]
                if member >= 0 and step < leaves[member] - 1:
                    node = node_start[member] + step
                    nodes[place + lane] = column[node]
                    nodes[place + lanes + lane] = np.uint8(limit[node])
                    nodes[place + 2 * lanes + lane] = np.uint8(first[node] - 128)
                else:
                    nodes[place + 2 * lanes + lane] = 255


@numba.njit(cache=True, nogil=True)
def _put_leaves(tree, steps, start, leaves, leaf_start, source, value):  # type: ignore[no-untyped-def]
    for group in range(tree.shape[0]):
        for lane in range(tree.shape[1]):
            member = tree[group, lane]
            if member >= 0:
                place = start[group] + lane * (steps[group] + 1)
                for leaf in range(leaves[member]):
                    value[place + leaf] = source[leaf_start[member] + leaf]


@numba.njit(cache=True, nogil=True)
def _link(trees, roots, left, right, node_start, new_root, source, inner, new_left):  # type: ignore[no-untyped-def]
    """Orders the nodes of each tree breadth first; names of inner nodes are their in-order ones."""
    leaves = np.empty(left.size, dtype=np.int32)
    lowest = np.empty(left.size, dtype=np.int32)
    for place in range(trees.size):
        root, stop, start = roots[trees[place]], roots[trees[place] + 1], new_root[place]
        for node in range(stop - 1, root - 1, -1):
            is_leaf = left[node] == LEAF
            leaves[node] = 1 if is_leaf else leaves[root + left[node]] + leaves[root + right[node]]
        lowest[root] = 0
        source[start] = root
        filled = start + 1
        for new in range(start, start + stop - root):
            node = source[new]
            if left[node] == LEAF:
                new_left[new], inner[new] = new, -1
                continue
            low, high = root + left[node], root + right[node]
            lowest[low], lowest[high] = lowest[node], lowest[node] + leaves[low]
            inner[new] = node_start[trees[place]] + lowest[high] - 1
            new_left[new] = filled
            source[filled], source[filled + 1] = low, high
            filled += 2

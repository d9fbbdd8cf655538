"""A regression forest: every tree's nodes in parallel arrays, checked once."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.errors import ArtifactError
from taxel_server.runtimes.compiled.compiling import compiled

LEAF: Final = -1
"""The right child of a node that has no children."""

_FAULTS: Final = (
    "",
    "a child that is not a node of the tree",
    "a node with only one child",
    "a node reached twice: its children form no tree",
    "a feature that the model does not have",
)


@dataclass(frozen=True)
class Forest:
    """Trees whose leaves are added, in order, to a base score: output o sums the trees that name it.

    A row goes left where its feature is below the threshold (both float32), and where the feature
    is NaN and `default_left` says so. Nodes stand in preorder, so a left child follows its parent;
    a right child is numbered within its tree.

    Attributes:
        features: number of inputs.
        base_score: (outputs,) float32.
        roots: (trees + 1,) int64, each tree's first node; the last entry is the number of nodes.
        outputs: (trees,) int32, the output that each tree adds to.
        right: (nodes,) int32, right child or LEAF.
        feature: (nodes,) int32.
        default_left: (nodes,) bool.
        value: (nodes,) float32, the threshold, or the leaf's value.
    """

    features: int
    base_score: NDArray[np.float32]
    roots: NDArray[np.int64]
    outputs: NDArray[np.int32]
    right: NDArray[np.int32]
    feature: NDArray[np.int32]
    default_left: NDArray[np.bool_]
    value: NDArray[np.float32]

    @property
    def trees(self) -> int:
        """Number of trees."""
        return len(self.outputs)

    @property
    def nodes(self) -> int:
        """Number of nodes, leaves included."""
        return len(self.right)

    @property
    def by_output(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(trees,) The trees of output after output, each output's in order; (outputs + 1,) its first."""
        order = np.argsort(self.outputs, kind="stable")
        return order, np.searchsorted(self.outputs[order], np.arange(len(self.base_score) + 1))

    @property
    def rounds(self) -> NDArray[np.int64]:
        """(trees,) The place of each tree among those of its output."""
        order, start = self.by_output
        rounds = np.empty(self.trees, dtype=np.int64)
        rounds[order] = np.arange(self.trees) - start[self.outputs[order]]
        return rounds

    def in_preorder(self, left: NDArray[np.int32]) -> Self:
        """The same forest with its nodes in preorder, and without those that no row can reach.

        Args:
            left: (nodes,) the left children of nodes in any order, numbered within their tree, or LEAF.

        Raises:
            ArtifactError: the nodes of a tree form no binary tree; the text names tree and node.
        """
        order = np.empty(self.nodes, dtype=np.int64)
        right, roots = np.full_like(self.right, LEAF), np.zeros_like(self.roots)
        fault, tree, node = _preorder(
            self.features, self.roots, left, self.right, self.feature, order, right, roots
        )
        if fault:
            raise ArtifactError(f"tree {tree}, node {node}: {_FAULTS[fault]}")
        reached = order[: roots[-1]]
        return type(self)(
            features=self.features,
            base_score=self.base_score,
            roots=roots,
            outputs=self.outputs,
            right=right[: roots[-1]].copy(),
            feature=self.feature[reached],
            default_left=self.default_left[reached],
            value=self.value[reached],
        )


@compiled
def _preorder(
    features: int,
    roots: NDArray[np.int64],
    left: NDArray[np.int32],
    right: NDArray[np.int32],
    feature: NDArray[np.int32],
    order: NDArray[np.int64],
    new_right: NDArray[np.int32],
    new_roots: NDArray[np.int64],
) -> tuple[int, int, int]:
    """Walks every tree once; returns a fault's number (0: none) with its tree and node.

    Of a node that waits, `parents` has the new number of the parent if it is a right child, otherwise -1.
    """
    seen = np.zeros(left.size, dtype=np.bool_)
    stack = np.empty(left.size + 1, dtype=np.int64)
    parents = np.empty(left.size + 1, dtype=np.int64)
    placed = 0
    for tree in range(roots.size - 1):
        root, size, first = roots[tree], roots[tree + 1] - roots[tree], placed
        stack[0], parents[0], depth = 0, -1, 1
        while depth:
            depth -= 1
            node, parent = stack[depth], parents[depth]
            if seen[root + node]:
                return 3, tree, node
            seen[root + node] = True
            if parent >= 0:
                new_right[parent] = placed - first
            order[placed] = root + node
            low, high = left[root + node], right[root + node]
            if (low == LEAF) != (high == LEAF):
                return 2, tree, node
            if low != LEAF:
                if min(low, high) < 0 or max(low, high) >= size:
                    return 1, tree, node
                if feature[root + node] < 0 or feature[root + node] >= features:
                    return 4, tree, node
                stack[depth], parents[depth] = high, placed
                stack[depth + 1], parents[depth + 1] = low, -1
                depth += 2
            placed += 1
        new_roots[tree + 1] = placed
    return 0, 0, 0

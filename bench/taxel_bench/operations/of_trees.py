"""Counts the operations of a forest for one window.

The rule: a comparison for each inner node on the path from a tree's root to the leaf that a window
reaches, and an addition for each tree; the mean over windows. It counts what walking the trees
needs. An engine may do more comparisons in less time, as ours does, and is not credited for them.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def leaf_depths(tree: dict[str, Any]) -> NDArray[np.int64]:
    """Inner nodes above each node of a tree in XGBoost's JSON, (nodes,)."""
    depths = np.zeros(len(tree["left_children"]), np.int64)
    open_nodes = [0]
    while open_nodes:
        node = open_nodes.pop()
        for child in (tree["left_children"][node], tree["right_children"][node]):
            if child >= 0:
                depths[child] = depths[node] + 1
                open_nodes.append(child)
    return depths


def count_tree_operations(depths: Sequence[NDArray[np.int64]], leaves: NDArray[np.integer[Any]]) -> float:
    """Comparisons and additions that trees need for a window, by the mean.

    Args:
        depths: `leaf_depths` of each tree.
        leaves: (windows, trees) the node at which each window ends in each tree.
    """
    comparisons = sum(own[column].mean() for own, column in zip(depths, leaves.T, strict=True))
    return float(comparisons) + len(depths)

"""Evaluates a forest node by node: for trees that no faster form can hold, and to check the others."""

import numba
import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.forest import LEAF, Forest

_ROWS = 64
"""Rows that go through one tree while it is in the cache."""


def walk(forest: Forest, windows: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, features) to (n, outputs), bit for bit what XGBoost predicts."""
    result = np.empty((len(windows), len(forest.base_score)), dtype=np.float32)
    _walk(
        forest.roots,
        forest.outputs,
        forest.left,
        forest.right,
        forest.feature,
        forest.default_left,
        forest.value,
        forest.base_score,
        windows,
        result,
    )
    return result


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _walk(roots, outputs, left, right, feature, default_left, value, base_score, windows, result):  # type: ignore[no-untyped-def]
    for first in range(0, windows.shape[0], _ROWS):
        rows = range(first, min(first + _ROWS, windows.shape[0]))
        for row in rows:
            for output in range(base_score.size):
                result[row, output] = base_score[output]
        for tree in range(outputs.size):
            root, output = roots[tree], outputs[tree]
            for row in rows:
                node = root
                while left[node] != LEAF:
                    x = windows[row, feature[node]]
                    go_left = default_left[node] if np.isnan(x) else x < value[node]
                    node = root + (left[node] if go_left else right[node])
                result[row, output] += value[node]

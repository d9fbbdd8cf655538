"""Walks a forest from node to node: the reference for faster evaluators, and what runs where none fits."""

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.normalisation import Scales
from taxel_server.runtimes.trees.reading.forest import LEAF, Forest


class NodeWalkEvaluator:
    """A forest of any size, on any processor."""

    name = "node-walk"

    def __init__(self, forest: Forest, scales: Scales) -> None:
        self._forest = forest
        self._scales = scales

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32]) -> None:
        """Fills `result` (n, outputs) with the forest's outputs for `windows` (n, features)."""
        result[:] = walk(self._forest, self._scales, windows)


def walk(forest: Forest, scales: Scales, windows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Evaluates windows (n, features) to (n, outputs); XGBoost and `taxel.scaling` give the same bits."""
    if scales.applied:
        windows = (windows - scales.input_mean) / scales.input_std
    result = np.empty((len(windows), len(forest.base_score)), dtype=np.float32)
    _walk(
        forest.roots,
        forest.outputs,
        forest.right,
        forest.feature,
        forest.default_left,
        forest.value,
        forest.base_score,
        # Numba compiles a function anew for each kind of array: read-only, aligned or not.
        windows.copy(),
        result,
    )
    return result * scales.output_std + scales.output_mean if scales.applied else result


@compiled
def _walk(
    roots: NDArray[np.int64],
    outputs: NDArray[np.int32],
    right: NDArray[np.int32],
    feature: NDArray[np.int32],
    default_left: NDArray[np.bool_],
    value: NDArray[np.float32],
    base_score: NDArray[np.float32],
    windows: NDArray[np.float32],
    result: NDArray[np.float32],
) -> None:
    for row in range(windows.shape[0]):
        for output in range(base_score.size):
            result[row, output] = base_score[output]
        for tree in range(outputs.size):
            root = roots[tree]
            node = root
            while right[node] != LEAF:
                x = windows[row, feature[node]]
                go_left = default_left[node] if np.isnan(x) else x < value[node]
                node = node + 1 if go_left else root + right[node]
            result[row, outputs[tree]] += value[node]

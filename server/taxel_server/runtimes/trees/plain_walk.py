"""What a forest says of a row, plainly: from node to node; every faster form is checked against it."""

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.normalisation import Scales
from taxel_server.runtimes.trees.reading.forest import LEAF, Forest


def walk(forest: Forest, scales: Scales, windows: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, features) to (n, outputs), with the bits that XGBoost and `taxel.scaling` give."""
    if scales.applied:
        windows = (windows - scales.input_mean) / scales.input_std
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
    return result * scales.output_std + scales.output_mean if scales.applied else result


@compiled
def _walk(roots, outputs, left, right, feature, default_left, value, base_score, windows, result):  # type: ignore[no-untyped-def]
    for row in range(windows.shape[0]):
        for output in range(base_score.size):
            result[row, output] = base_score[output]
        for tree in range(outputs.size):
            root = roots[tree]
            node = root
            while left[node] != LEAF:
                x = windows[row, feature[node]]
                go_left = default_left[node] if np.isnan(x) else x < value[node]
                node = root + (left[node] if go_left else right[node])
            result[row, outputs[tree]] += value[node]

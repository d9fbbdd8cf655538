"""Compares a block of rows with every cut of a forest. Each comparison is made once for all its nodes."""

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.layout.columns import Cuts
from taxel_server.runtimes.trees.normalisation import Scales
from taxel_server.runtimes.trees.simd.bits import not_below


@compiled
def _load_feature(
    scales: Scales, windows: NDArray[np.float32], first: int, feature: int, x: NDArray[np.float32]
) -> None:
    """Reads a feature of a block of rows and fills the block with the last row.

    Place 8 j + k is for lane k lanes / 8 + j.
    """
    eighth = x.size // 8
    for lane in range(x.size):
        row = min(first + lane, windows.shape[0] - 1)
        x[lane % eighth * 8 + lane // eighth] = windows[row, feature]
    if scales.applied:
        for lane in range(x.size):
            x[lane] = (x[lane] - scales.input_mean[feature]) / scales.input_std[feature]


@compiled
def compare(
    columns: Cuts,
    scales: Scales,
    windows: NDArray[np.float32],
    first: int,
    x: NDArray[np.float32],
    comparisons: NDArray[np.int64],
) -> None:
    """Compares a block of rows with all cuts: a bit is set where a row goes right."""
    values, parts = x.ctypes.data, x.size // 64
    feature = -1
    for column in range(columns.feature.size):
        if feature != columns.feature[column]:
            feature = columns.feature[column]
            _load_feature(scales, windows, first, feature, x)
        start, stop = columns.start[column], columns.start[column + 1]
        for part in range(parts):
            rows = values + 256 * part
            # Two loops: from one loop, LLVM would make code that chooses bit by bit.
            if columns.default_left[column]:
                for place in range(start, stop):
                    comparisons[place * parts + part] = not_below(rows, columns.cuts[place], False)
            else:
                for place in range(start, stop):
                    comparisons[place * parts + part] = not_below(rows, columns.cuts[place], True)

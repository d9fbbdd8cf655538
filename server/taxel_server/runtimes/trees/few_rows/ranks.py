"""Ranks a few rows among the cuts of every column. Sixteen cuts are compared at once."""

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.compiled.vectors import count, load_floats, not_above, splat_float
from taxel_server.runtimes.trees.layout.columns import Columns, Cuts
from taxel_server.runtimes.trees.normalisation import Scales

ROWS: Final = 8
"""How many rows are ranked and go through a group of trees at once."""

_BLOCK: Final = 16
"""How many cuts are compared at once: a cache line of float32."""

_MISSING_GOES_RIGHT: Final = 255
_BIAS: Final = 128


def padded_cuts(columns: Columns) -> Cuts:
    """The cuts of columns, each column's a whole number of cache lines. `together` aligns them.

    NaN, which is never <= x, fills a column's last line.
    """
    feature, default_left, starts, cuts = columns.cuts
    padded = [np.empty(0, dtype=np.float32)]
    for first, stop in pairwise(starts):
        padded += [cuts[first:stop], np.full(-(stop - first) % _BLOCK, np.nan, dtype=np.float32)]
    lengths = -(-np.diff(starts) // _BLOCK) * _BLOCK
    return Cuts(feature, default_left, np.cumsum([0, *lengths]), np.concatenate(padded))


@compiled
def rank_rows(
    columns: Cuts,
    scales: Scales,
    windows: NDArray[np.float32],
    first: int,
    rows: int,
    size: int,
    ranks: NDArray[np.int8],
) -> None:
    """Writes the ranks [row][column] of some rows, less 128; a row takes `size` bytes.

    A missing value gets the lowest rank in columns whose nodes send it left, and the highest in others.
    """
    cuts = columns.cuts.ctypes.data
    for column in range(columns.feature.size):
        feature = columns.feature[column]
        for row in range(rows):
            x = windows[first + row, feature]
            if scales.applied:
                x = (x - scales.input_mean[feature]) / scales.input_std[feature]
            rank, everywhere = 0, splat_float(x, _BLOCK)
            for place in range(columns.start[column], columns.start[column + 1], _BLOCK):
                rank += count(not_above(load_floats(cuts + 4 * place, _BLOCK), everywhere))
            if np.isnan(x) and not columns.default_left[column]:
                rank = _MISSING_GOES_RIGHT
            ranks[row * size + column] = rank - _BIAS

"""Ranks a few rows among the cuts of every column: sixteen cuts are compared at once."""

from itertools import pairwise
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import array_in, together
from taxel_server.runtimes.compiled.compiling import compiled, inlined
from taxel_server.runtimes.compiled.vectors import count, load_floats, not_above, splat_float
from taxel_server.runtimes.trees.layout.columns import Columns
from taxel_server.runtimes.trees.normalisation import Scales

ROWS: Final = 8
"""Rows that are ranked, and go through a group of trees, at once."""

_BLOCK: Final = 16
"""Cuts that are compared at once; as float32, a cache line."""

_MISSING_GOES_RIGHT: Final = 255
_BIAS: Final = 128


class Ranking(NamedTuple):
    """Columns of at most 255 cuts as a row is ranked among them.

    Attributes:
        feature: (columns,) int32.
        default_left: (columns,) bool.
        start: (columns + 1,) int64, each column's first cut.
        cuts: float32, each column's in whole blocks, filled up with NaN, which is never <= x.
    """

    feature: NDArray[np.int32]
    default_left: NDArray[np.bool_]
    start: NDArray[np.int64]
    cuts: NDArray[np.float32]

    @classmethod
    def of(cls, columns: Columns) -> Self:
        """Lays out the cuts of columns, each from the start of a cache line."""
        feature, default_left, starts, cuts = columns.cuts
        padded = [np.empty(0, dtype=np.float32)]
        for first, stop in pairwise(starts):
            padded += [cuts[first:stop], np.full(-(stop - first) % _BLOCK, np.nan, dtype=np.float32)]
        lengths = -(-np.diff(starts) // _BLOCK) * _BLOCK
        (aligned,) = together(np.concatenate(padded))
        return cls(feature, default_left, np.cumsum([0, *lengths]), aligned)


@inlined
def read_ranking(arguments: NDArray[np.int64], first: int) -> Ranking:
    """The ranking that is packed from an entry of the arguments on."""
    return Ranking(
        array_in(arguments, first, np.int32),
        array_in(arguments, first + 1, np.bool_),
        array_in(arguments, first + 2, np.int64),
        array_in(arguments, first + 3, np.float32),
    )


@compiled
def rank_rows(
    ranking: Ranking,
    scales: Scales,
    windows: NDArray[np.float32],
    first: int,
    rows: int,
    size: int,
    ranks: NDArray[np.int8],
) -> None:
    """Ranks [row][column] of some rows, biased; a row of them takes `size` bytes.

    A missing value has the lowest rank in the columns whose nodes send it left, else the highest.
    """
    cuts = ranking.cuts.ctypes.data
    for column in range(ranking.feature.size):
        feature = ranking.feature[column]
        for row in range(rows):
            x = windows[first + row, feature]
            if scales.applied:
                x = (x - scales.input_mean[feature]) / scales.input_std[feature]
            rank, everywhere = 0, splat_float(x, _BLOCK)
            for place in range(ranking.start[column], ranking.start[column + 1], _BLOCK):
                rank += count(not_above(load_floats(cuts + 4 * place, _BLOCK), everywhere))
            if np.isnan(x) and not ranking.default_left[column]:
                rank = _MISSING_GOES_RIGHT
            ranks[row * size + column] = rank - _BIAS

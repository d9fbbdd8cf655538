"""Ranks: what a row's values become among the cuts of a forest's columns.

A missing value has rank 0 in the columns of nodes that then go left, and the highest rank in the
others': nothing tests for it any more.

The cuts are searched sixteen at a time (k-ary search, Schlegel and others, DaMoN 2009): a column's last
level has all of its cuts, in blocks of sixteen, and every level above has the last of each block below.
How many of a block are <= x says which block comes next. Two cache lines find a place among 255.
"""

from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import array_in, number_in, together
from taxel_server.runtimes.compiled.compiling import compiled, inlined
from taxel_server.runtimes.compiled.vectors import count, load_floats, not_above, splat_float
from taxel_server.runtimes.trees.layout.columns import Columns

ROWS: Final = 8
"""Rows that are ranked, and go through a group of trees, at once."""

_BLOCK: Final = 16
"""Cuts that are compared at once; as float32, a cache line."""


class Ranking(NamedTuple):
    """Columns as a search takes them.

    Attributes:
        feature: (columns,) int32.
        default_left: (columns,) bool.
        levels: of every column.
        start: (columns * levels,) int64, the first cut of each column's levels, the least level first.
        cuts: float32, in whole blocks, of which the last of a level ends with a NaN: it is never <= x.
    """

    feature: NDArray[np.int32]
    default_left: NDArray[np.bool_]
    levels: int
    start: NDArray[np.int64]
    cuts: NDArray[np.float32]

    @classmethod
    def of(cls, columns: Columns) -> Self:
        """Lays out the cuts of columns, each from the start of a cache line."""
        every = [
            _levels(columns.cuts[first:stop])
            for first, stop in zip(columns.start, columns.start[1:], strict=False)
        ]
        most = max(map(len, every), default=0)
        # A level of nothing but NaN leads to the first block below.
        blocks = [
            level
            for levels in every
            for level in [np.full(_BLOCK, np.nan, np.float32)] * (most - len(levels)) + levels
        ]
        start = np.cumsum([0, *map(len, blocks)])[:-1]
        (cuts,) = together(np.concatenate([np.empty(0, np.float32), *blocks]))
        return cls(columns.feature, columns.default_left, most, start, cuts)


@inlined
def read_ranking(plan: NDArray[np.int64], first: int) -> Ranking:
    """A ranking, packed from an entry of a plan on."""
    return Ranking(
        array_in(plan, first, np.int32),
        array_in(plan, first + 1, np.bool_),
        number_in(plan, first + 2),
        array_in(plan, first + 3, np.int64),
        array_in(plan, first + 4, np.float32),
    )


def _levels(cuts: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """A column's levels, the least first."""
    level = np.full((len(cuts) // _BLOCK + 1) * _BLOCK, np.nan, dtype=np.float32)
    level[: len(cuts)] = cuts
    if len(level) == _BLOCK:
        return [level]
    return [*_levels(level[_BLOCK - 1 : -1 : _BLOCK]), level]


@compiled
def rank_rows(ranking, scales, windows, first, rows, highest, bias, size, ranks):  # type: ignore[no-untyped-def]
    """Ranks [row][column] of some rows, less the bias; 0 or `highest` for a missing value."""
    cuts, levels = ranking.cuts.ctypes.data, ranking.levels
    for column in range(ranking.feature.size):
        feature = ranking.feature[column]
        for row in range(rows):
            x = windows[first + row, feature]
            if scales.applied:
                x = (x - scales.input_mean[feature]) / scales.input_std[feature]
            place, everywhere = 0, splat_float(x, _BLOCK)
            for level in range(column * levels, (column + 1) * levels):
                block = load_floats(cuts + 4 * (ranking.start[level] + _BLOCK * place), _BLOCK)
                place = _BLOCK * place + count(not_above(block, everywhere))
            if np.isnan(x) and not ranking.default_left[column]:
                place = highest
            ranks[row * size + column] = place - bias

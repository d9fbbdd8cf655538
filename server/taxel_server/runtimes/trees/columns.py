"""Ranks: inputs as small integers that compare with a forest's thresholds as the floats do.

A column is one (feature, default direction, run of cuts), its cuts sorted. The rank of x in it is
the number of cuts <= x, so that x < cuts[bin] exactly where rank <= bin. A missing value has rank 0
in the columns of nodes that then go left, and the highest rank in the others': nothing tests for
it any more. Ranks and bins are stored less 2**(bits - 1), as signed integers.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numba
import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.caching import fresh
from taxel_server.runtimes.compiled.plans import array_at
from taxel_server.runtimes.compiled.vectors import load_floats, not_above, plus, select, splat, store
from taxel_server.runtimes.trees.in_order import InOrder
from taxel_server.runtimes.trees.words import elements, floats_at

ROWS: Final = 8
"""Rows that are ranked, and go through a group of trees, at once."""


@dataclass(frozen=True)
class Columns:
    """The columns of a forest, and where each of its inner nodes stands in them.

    Attributes:
        bits: 8 or 16, the size of a rank.
        feature: (columns,) int32.
        default_left: (columns,) bool.
        start: (columns + 1,) int64, each column's first cut; the last entry is their number.
        cuts: (cuts,) float32, ascending within a column.
        column: (inner nodes,) int32; only set for the chosen trees, as is `limit`.
        limit: (inner nodes,) int16, the least rank that goes right, biased.
    """

    bits: int
    feature: NDArray[np.int32]
    default_left: NDArray[np.bool_]
    start: NDArray[np.int64]
    cuts: NDArray[np.float32]
    column: NDArray[np.int32]
    limit: NDArray[np.int16]

    @classmethod
    def of(cls, forest: InOrder, bits: int, trees: NDArray[np.int64]) -> Self:
        """Sorts some trees' thresholds by feature and direction; long lists become several columns."""
        most = 2**bits - 1
        chosen = np.flatnonzero(np.repeat(np.isin(np.arange(len(forest.leaves)), trees), forest.leaves - 1))
        code = (forest.feature[chosen] * 2 + forest.default_left[chosen]).astype(np.uint32)
        order = np.argsort(code, kind="stable")
        column = np.empty(len(forest.feature), dtype=np.int32)
        limit = np.empty(len(forest.feature), dtype=np.int16)
        features, defaults, cuts = list[int](), list[bool](), list[NDArray[np.float32]]()
        codes, begins = np.unique(code[order], return_index=True)
        runs = np.split(chosen[order], begins[1:]) if len(codes) else []
        for members, value in zip(runs, codes.tolist(), strict=True):
            values, place = np.unique(forest.threshold[members], return_inverse=True)
            column[members] = len(cuts) + place // most
            limit[members] = place % most + 1 - 2 ** (bits - 1)
            for first in range(0, len(values), most):
                features.append(value // 2)
                defaults.append(bool(value % 2))
                cuts.append(values[first : first + most])
        return cls(
            bits=bits,
            feature=np.array(features, dtype=np.int32),
            default_left=np.array(defaults, dtype=np.bool_),
            start=np.cumsum([0, *map(len, cuts)]),
            cuts=np.concatenate(cuts) if cuts else np.empty(0, dtype=np.float32),
            column=column,
            limit=limit,
        )

    def __len__(self) -> int:
        return len(self.feature)

    @property
    def comparison(self) -> NDArray[np.int64]:
        """(inner nodes,) The place among all cuts of each node's threshold, for the chosen trees."""
        comparison: NDArray[np.int64] = self.start[self.column] + self.limit + (2 ** (self.bits - 1) - 1)
        return comparison

    @property
    def ranking(self) -> "Ranking":
        """What it takes to rank rows."""
        return Ranking(self.feature, self.default_left, self.start, self.cuts)


class Ranking(NamedTuple):
    """Columns as compiled code takes them."""

    feature: NDArray[np.int32]
    default_left: NDArray[np.bool_]
    start: NDArray[np.int64]
    cuts: NDArray[np.float32]


@numba.njit(cache=True)
@fresh
def ranking_at(plan, entry):  # type: ignore[no-untyped-def]
    """The ranking that begins at an entry of a plan."""
    return Ranking(
        array_at(plan, entry, np.int32),
        array_at(plan, entry + 1, np.bool_),
        array_at(plan, entry + 2, np.int64),
        array_at(plan, entry + 3, np.float32),
    )


class RankScratch(NamedTuple):
    """What ranking some rows writes to: their values of a feature, and their places among its cuts."""

    x: NDArray[np.float32]
    places: NDArray[np.int64]

    @classmethod
    def make(cls) -> Self:
        """Memory for ROWS rows."""
        return cls(np.zeros(ROWS, dtype=np.float32), np.zeros(ROWS, dtype=np.int64))


@numba.njit(cache=True)
@fresh
def rank_scratch_at(memory, entry):  # type: ignore[no-untyped-def]
    """The RankScratch that begins at an entry of a scratch's plan."""
    return RankScratch(array_at(memory, entry, np.float32), array_at(memory, entry + 1, np.int64))


@numba.njit(cache=True, nogil=True)
@fresh
def _find_places(cuts, scratch):  # type: ignore[no-untyped-def]
    """How many of the cuts are <= x, for ROWS rows in step; 0 for a missing value."""
    start, length = cuts.ctypes.data, cuts.size
    x, low = load_floats(scratch.x.ctypes.data, ROWS), splat(0, 64, ROWS)
    while length > 1:
        half = length >> 1
        reached = not_above(floats_at(elements(start + 4 * (half - 1), low, 4)), x)
        low = plus(low, select(reached, splat(half, 64, ROWS), splat(0, 64, ROWS)))
        length -= half
    reached = not_above(floats_at(elements(start, low, 4)), x)
    store(scratch.places.ctypes.data, plus(low, select(reached, splat(1, 64, ROWS), splat(0, 64, ROWS))))


@numba.njit(cache=True, nogil=True)
@fresh
def rank_rows(ranking, scales, windows, first, rows, highest, bias, size, scratch, ranks):  # type: ignore[no-untyped-def]
    """Ranks [row][column] of at most ROWS rows, less the bias; 0 or `highest` for a missing value."""
    for column in range(ranking.feature.size):
        feature = ranking.feature[column]
        for row in range(rows):
            x = windows[first + row, feature]
            if scales.applied:
                x = (x - scales.input_mean[feature]) / scales.input_std[feature]
            scratch.x[row] = x
        _find_places(ranking.cuts[ranking.start[column] : ranking.start[column + 1]], scratch)
        for row in range(rows):
            place = scratch.places[row]
            if np.isnan(scratch.x[row]) and not ranking.default_left[column]:
                place = highest
            ranks[row * size + column] = place - bias

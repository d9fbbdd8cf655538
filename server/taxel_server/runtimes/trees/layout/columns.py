"""Columns: a forest's thresholds, sorted, so that small integers compare with them as the floats do.

A column is one (feature, default direction, run of cuts), its cuts sorted. The rank of x in it is
the number of cuts <= x, so that x < cuts[bin] exactly where rank <= bin. Ranks and bins are stored less
2**(bits - 1), as signed integers.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import array_in
from taxel_server.runtimes.compiled.compiling import inlined
from taxel_server.runtimes.trees.layout.in_order import InOrder


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
    def plain(self) -> "PlainColumns":
        """For compiled code."""
        return PlainColumns(self.feature, self.default_left, self.start, self.cuts)


class PlainColumns(NamedTuple):
    """Columns as compiled code takes them, their cuts one after the other."""

    feature: NDArray[np.int32]
    default_left: NDArray[np.bool_]
    start: NDArray[np.int64]
    cuts: NDArray[np.float32]


@inlined
def read_columns(plan: NDArray[np.int64], first: int) -> PlainColumns:
    """Columns, packed from an entry of a plan on."""
    return PlainColumns(
        array_in(plan, first, np.int32),
        array_in(plan, first + 1, np.bool_),
        array_in(plan, first + 2, np.int64),
        array_in(plan, first + 3, np.float32),
    )

"""Ranks: inputs as small integers that compare with a forest's thresholds as the floats do.

A column is one (feature, default direction, run of cuts), its cuts sorted. The rank of x in it is
the number of cuts <= x, so that x < cuts[bin] exactly where rank <= bin. A missing value has rank 0
in the columns of nodes that then go left, and the highest rank in the others': nothing tests for
it any more. Ranks and bins are stored less 2**(bits - 1), as signed integers.
"""

from dataclasses import dataclass
from typing import Self

import numba
import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.in_order import InOrder


@dataclass(frozen=True)
class Columns:
    """The columns of a forest, and where each of its inner nodes stands in them.

    Attributes:
        bits: 8 or 16, the size of a rank.
        feature: (columns,) int32.
        default_left: (columns,) bool.
        start: (columns + 1,) int64, each column's first cut; the last entry is their number.
        cuts: (cuts,) float32, ascending within a column.
        column: (inner nodes,) int32.
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
    def of(cls, forest: InOrder, bits: int) -> Self:
        """Sorts the thresholds of every feature and direction, and cuts long lists into several columns."""
        most = 2**bits - 1
        code = (forest.feature * 2 + forest.default_left).astype(np.uint16)
        order = np.argsort(code, kind="stable")
        column = np.empty(len(code), dtype=np.int32)
        limit = np.empty(len(code), dtype=np.int16)
        features, defaults, cuts = list[int](), list[bool](), list[NDArray[np.float32]]()
        codes, begins = np.unique(code[order], return_index=True)
        for members, value in zip(np.split(order, begins[1:]), codes.tolist(), strict=True) if len(codes) else ():
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


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def rank(x, cuts, start, stop, default_left, highest):  # type: ignore[no-untyped-def]
    """How many of cuts[start:stop] are <= x; 0 or `highest` for a missing value."""
    if np.isnan(x):
        return np.int32(0 if default_left else highest)
    if stop - start > 256:
        low, high = start, stop
        while low < high:
            middle = (low + high) >> 1
            if cuts[middle] <= x:
                low = middle + 1
            else:
                high = middle
        return np.int32(low - start)
    count = np.int32(0)
    for place in range(start, stop):
        count = np.int32(count + (cuts[place] <= x))
    return count

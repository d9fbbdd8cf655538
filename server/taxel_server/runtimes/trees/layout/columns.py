"""Columns: a forest's sorted thresholds. Small integers, the ranks, then compare as the floats do.

A column is one (feature, default direction, run of cuts), its cuts sorted. The rank of x in it is
the number of cuts <= x. So x < cuts[bin] exactly if rank <= bin. Ranks and bins are stored as signed
bytes, less BIAS.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import array_in
from taxel_server.runtimes.compiled.compiling import inlined
from taxel_server.runtimes.trees.layout.in_order import InOrder

_MOST_CUTS: Final = 255
BIAS: Final = 128
"""What a stored rank or bin is less than the number itself."""


class Cuts(NamedTuple):
    """Columns as compiled code takes them.

    Attributes:
        feature: (columns,) int32.
        default_left: (columns,) bool.
        start: (columns + 1,) int64, each column's first cut; the last entry is their number.
        cuts: (cuts,) float32, ascending within a column.
    """

    feature: NDArray[np.int32]
    default_left: NDArray[np.bool_]
    start: NDArray[np.int64]
    cuts: NDArray[np.float32]


@inlined
def read_cuts(arguments: NDArray[np.int64], first: int) -> Cuts:
    """The cuts that are packed from an entry of the arguments on."""
    return Cuts(
        array_in(arguments, first, np.int32),
        array_in(arguments, first + 1, np.bool_),
        array_in(arguments, first + 2, np.int64),
        array_in(arguments, first + 3, np.float32),
    )


@dataclass(frozen=True)
class Columns:
    """The columns of a forest, and where each of its inner nodes stands in them.

    Attributes:
        cuts: of the columns.
        column: (inner nodes,) int32.
        limit: (inner nodes,) int8, the least rank that goes right, biased.
    """

    cuts: Cuts
    column: NDArray[np.int32]
    limit: NDArray[np.int8]

    @classmethod
    def of(cls, forest: InOrder) -> Self:
        """Sorts all thresholds by feature and direction; long lists become several columns."""
        code = (forest.feature * 2 + forest.default_left).astype(np.uint32)
        order = np.argsort(code, kind="stable")
        column = np.empty(len(forest.feature), dtype=np.int32)
        limit = np.empty(len(forest.feature), dtype=np.int8)
        features, defaults, cuts = list[int](), list[bool](), list[NDArray[np.float32]]()
        codes, begins = np.unique(code[order], return_index=True)
        runs = np.split(order, begins[1:]) if len(codes) else []
        for members, value in zip(runs, codes.tolist(), strict=True):
            values, place = np.unique(forest.threshold[members], return_inverse=True)
            column[members] = len(cuts) + place // _MOST_CUTS
            limit[members] = place % _MOST_CUTS + 1 - BIAS
            for first in range(0, len(values), _MOST_CUTS):
                features.append(value // 2)
                defaults.append(bool(value % 2))
                cuts.append(values[first : first + _MOST_CUTS])
        sorted_cuts = Cuts(
            np.array(features, dtype=np.int32),
            np.array(defaults, dtype=np.bool_),
            np.cumsum([0, *map(len, cuts)]),
            np.concatenate([np.empty(0, dtype=np.float32), *cuts]),
        )
        return cls(sorted_cuts, column, limit)

    def __len__(self) -> int:
        return len(self.cuts.feature)

    @property
    def comparison(self) -> NDArray[np.int64]:
        """(inner nodes,) The place of each node's threshold among all cuts."""
        start = self.cuts.start[self.column]
        comparison: NDArray[np.int64] = start + self.limit + (BIAS - 1)
        return comparison

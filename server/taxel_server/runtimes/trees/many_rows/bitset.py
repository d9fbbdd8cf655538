"""Evaluates many rows: blocks of rows pass through all trees as bitsets, then the leaves are summed."""

from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel_server.runtimes.compiled.arguments import array_in, number_in, together
from taxel_server.runtimes.compiled.compiling import compiled, inlined
from taxel_server.runtimes.compiled.evaluator import CompiledEvaluator
from taxel_server.runtimes.compiled.vectors import call
from taxel_server.runtimes.trees.layout.bitsets import GROUP, BitsetTrees, LeafNumbers, split_sets
from taxel_server.runtimes.trees.layout.columns import Columns, Cuts, read_cuts
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.layout.leaf_tables import LEAVES, write_leaf_tables
from taxel_server.runtimes.trees.many_rows.leaf_sums import add_leaves
from taxel_server.runtimes.trees.many_rows.traversal import find_exits, memory_size
from taxel_server.runtimes.trees.normalisation import Scales, read_scales, restore
from taxel_server.runtimes.trees.reading.forest import Forest
from taxel_server.runtimes.trees.simd.bits import not_below
from taxel_server.runtimes.trees.simd.lookups import assembled_lane
from taxel_server.runtimes.trees.switches import Switches

_GROUP: Final = GROUP.itemsize

_MOST_NARROW_COMPARISONS: Final = 2**16 - 1


class _Trees(NamedTuple):
    """The trees whose leaf numbers have one size."""

    group_start: NDArray[np.int64]
    groups: int
    records: int
    upper: int
    sets: NDArray[np.int64]
    traversal: int


class _Sums(NamedTuple):
    """The leaves of all trees, output by output."""

    start: NDArray[np.int64]
    leaves: int
    tables: int
    addition: int
    base_score: NDArray[np.float32]
    lane: NDArray[np.int64]


class _Scratch(NamedTuple):
    x: NDArray[np.float32]
    comparisons: NDArray[np.int64]
    memory: NDArray[np.int64]
    exits: NDArray[np.uint8]
    sums: NDArray[np.float32]


@inlined
def _read_trees(arguments: NDArray[np.int64], first: int) -> _Trees:
    return _Trees(
        array_in(arguments, first, np.int64),
        number_in(arguments, first + 1),
        number_in(arguments, first + 2),
        number_in(arguments, first + 3),
        array_in(arguments, first + 4, np.int64),
        number_in(arguments, first + 5),
    )


@inlined
def _read_sums(arguments: NDArray[np.int64], first: int) -> _Sums:
    return _Sums(
        array_in(arguments, first, np.int64),
        number_in(arguments, first + 1),
        number_in(arguments, first + 2),
        number_in(arguments, first + 3),
        array_in(arguments, first + 4, np.float32),
        array_in(arguments, first + 5, np.int64),
    )


@inlined
def _read_scratch(arguments: NDArray[np.int64]) -> _Scratch:
    return _Scratch(
        array_in(arguments, 0, np.float32),
        array_in(arguments, 1, np.int64),
        array_in(arguments, 2, np.int64),
        array_in(arguments, 3, np.uint8),
        array_in(arguments, 4, np.float32),
    )


@dataclass(frozen=True)
class BitsetForest:
    """A whole forest for blocks of rows; its trees have at most 65,536 leaves.

    Attributes:
        cuts: the comparisons that its nodes make.
        narrow: the trees whose leaf numbers take one byte.
        wide: the trees whose leaf numbers take two bytes.
        most_numbers: the number of leaf numbers of the largest tree.
        leaves: (trees,) LEAVES, output by output; within an output, in the forest's order.
        start: (outputs + 1,) int64, each output's first entry in `leaves`.
        tables: (bytes,) uint8, all leaf tables.
        places: the most exits that one output needs.
        base_score: (outputs,) float32.
    """

    cuts: Cuts
    narrow: BitsetTrees
    wide: BitsetTrees
    most_numbers: int
    leaves: NDArray[np.void]
    start: NDArray[np.int64]
    tables: NDArray[np.uint8]
    places: int
    base_score: NDArray[np.float32]

    @classmethod
    def of(cls, forest: Forest, index: InOrder, columns: Columns, switches: Switches) -> Self:
        """Lays a forest out."""
        may_be_narrow = len(columns.cuts.cuts) <= _MOST_NARROW_COMPARISONS
        numbers = LeafNumbers.of(index, may_be_narrow, switches.upper_levels)
        small = numbers.small
        order, start = forest.by_output
        # Exits of two bytes take the room of two trees.
        ends = np.cumsum(np.where(small[order], 1, 2))
        begins = ends - np.where(small[order], 1, 2)
        places = np.empty(forest.trees, dtype=np.int64)
        places[order] = begins - np.append(begins, 0)[start[forest.outputs[order]]]
        most = int(places.max(initial=0)) + 2
        leaves = np.empty(forest.trees, dtype=LEAVES)
        leaves["exits"] = places[order]
        tables = write_leaf_tables(index, numbers, order, leaves, switches.byte_tables)
        narrow, wide = (
            BitsetTrees.of(index, numbers, columns, size, forest.outputs, places, most, len(start) - 1)
            for size in (1, 2)
        )
        largest = int(numbers.count.max(initial=1))
        laid_out = cls(
            columns.cuts, narrow, wide, largest, leaves, start, tables, most + 2, forest.base_score
        )
        return laid_out.placed()

    def placed(self) -> Self:
        """The same forest, its large arrays at the start of cache lines."""
        tables, *records = together(self.tables, self.narrow.records, self.wide.records)
        narrow, wide = replace(self.narrow, records=records[0]), replace(self.wide, records=records[1])
        return replace(self, narrow=narrow, wide=wide, tables=tables)

    @override
    def __reduce__(self) -> tuple[Any, ...]:
        fields = tuple(getattr(self, name) for name in self.__dataclass_fields__)
        return _placed, (type(self), *fields)


def _placed(kind: type[BitsetForest], *fields: Any) -> BitsetForest:
    """A forest from a pickle, which knows no cache lines."""
    return kind(*fields).placed()


class BitsetEvaluator(CompiledEvaluator):
    """A BitsetForest compiled for one block size."""

    def __init__(self, forest: BitsetForest, lanes: int, scales: Scales) -> None:
        self.name = f"bitset-{lanes}"
        narrow, wide = (
            _Trees(
                some.start,
                some.groups.ctypes.data,
                some.records.ctypes.data,
                2**some.upper - 1,
                split_sets(some.upper),
                find_exits(some.size, lanes) if len(some.groups) else 0,
            )
            for some in (forest.narrow, forest.wide)
        )
        lane = np.empty(lanes, dtype=np.int64)
        lane[assembled_lane(lanes)] = np.arange(lanes)
        sums = _Sums(
            forest.start,
            forest.leaves.ctypes.data,
            forest.tables.ctypes.data,
            add_leaves(lanes),
            forest.base_score,
            lane,
        )
        scratch = _Scratch(
            np.zeros(lanes, dtype=np.float32),
            # No block makes the last comparison: no row goes right there.
            np.zeros((len(forest.cuts.cuts) + 1) * lanes // 64, dtype=np.int64),
            np.zeros(memory_size(forest.most_numbers), dtype=np.int64),
            np.zeros(forest.places * lanes, dtype=np.uint8),
            np.zeros(lanes, dtype=np.float32),
        )
        arguments = (forest.cuts, narrow, wide, sums, scales)
        super().__init__((forest, lanes, scales), _evaluate, arguments, scratch)


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
def _compare(
    columns: Cuts,
    scales: Scales,
    windows: NDArray[np.float32],
    first: int,
    x: NDArray[np.float32],
    comparisons: NDArray[np.int64],
) -> None:
    """Compares a block of rows with all cuts, once for all nodes: a bit is set where a row goes right."""
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


@compiled
def _find_exits(trees: _Trees, output: int, scratch: _Scratch) -> None:
    """Writes the exits of one output's trees."""
    first, stop = trees.group_start[output], trees.group_start[output + 1]
    if first < stop:
        groups = trees.groups + first * _GROUP
        sets, memory = trees.sets.ctypes.data, scratch.memory.ctypes.data
        comparisons = scratch.comparisons.ctypes.data
        given = (stop - first, groups, trees.records, trees.upper, sets, comparisons, memory)
        call(trees.traversal, (*given, scratch.exits.ctypes.data))


_NARROW: Final = len(Cuts._fields)
_WIDE: Final = _NARROW + len(_Trees._fields)
_SUMS: Final = _WIDE + len(_Trees._fields)
_SCALES: Final = _SUMS + len(_Sums._fields)


@compiled
def _evaluate(
    arguments: NDArray[np.int64],
    memory: NDArray[np.int64],
    windows: NDArray[np.float32],
    result: NDArray[np.float32],
) -> None:
    cuts, scratch = read_cuts(arguments, 0), _read_scratch(memory)
    narrow, wide = _read_trees(arguments, _NARROW), _read_trees(arguments, _WIDE)
    sums, scales = _read_sums(arguments, _SUMS), read_scales(arguments, _SCALES)
    lanes = sums.lane.size
    exits, totals = scratch.exits.ctypes.data, scratch.sums.ctypes.data
    for first in range(0, windows.shape[0], lanes):
        rows = min(lanes, windows.shape[0] - first)
        _compare(cuts, scales, windows, first, scratch.x, scratch.comparisons)
        for output in range(sums.base_score.size):
            _find_exits(narrow, output, scratch)
            _find_exits(wide, output, scratch)
            for lane in range(lanes):
                scratch.sums[lane] = sums.base_score[output]
            count = sums.start[output + 1] - sums.start[output]
            leaves = sums.leaves + 16 * sums.start[output]
            call(sums.addition, (count, leaves, sums.tables, exits, totals, rows))
            for row in range(rows):
                result[first + row, output] = restore(scales, output, scratch.sums[sums.lane[row]])

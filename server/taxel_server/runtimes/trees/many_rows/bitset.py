"""The form of a forest for many rows: blocks of rows go through all trees, then the leaves are summed."""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import Scratch, array_in, number_in, pack, together
from taxel_server.runtimes.compiled.compiling import compiled, inlined
from taxel_server.runtimes.compiled.kernel import CompiledKernel
from taxel_server.runtimes.trees.layout.bitsets import GROUP, LeafNumbers, RowsLayout, split_sets
from taxel_server.runtimes.trees.layout.columns import Columns, PlainColumns, read_columns
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.layout.leaf_tables import LEAVES, write_leaf_tables
from taxel_server.runtimes.trees.many_rows.comparisons import compare
from taxel_server.runtimes.trees.many_rows.leaf_sums import add_leaves
from taxel_server.runtimes.trees.many_rows.traversal import find_exits, memory_words
from taxel_server.runtimes.trees.normalisation import Scales, read_scales, restore
from taxel_server.runtimes.trees.reading.forest import Forest
from taxel_server.runtimes.trees.simd.calls import call
from taxel_server.runtimes.trees.simd.lookups import assembled_lane

_GROUP: Final = GROUP.itemsize

_MOST_NARROW_COMPARISONS: Final = 2**16 - 1


class _Part(NamedTuple):
    """The trees whose leaf numbers have one size."""

    group_start: NDArray[np.int64]
    groups: int
    records: int
    full: int
    sets: int
    traversal: int


@inlined
def _read_part(plan: NDArray[np.int64], first: int) -> _Part:
    return _Part(
        array_in(plan, first, np.int64),
        number_in(plan, first + 1),
        number_in(plan, first + 2),
        number_in(plan, first + 3),
        number_in(plan, first + 4),
        number_in(plan, first + 5),
    )


class _Sums(NamedTuple):
    """The leaves of all trees, output by output."""

    start: NDArray[np.int64]
    table_start: NDArray[np.int64]
    leaves: int
    tables: int
    addition: int
    base_score: NDArray[np.float32]
    lane: NDArray[np.int64]


@inlined
def _read_sums(plan: NDArray[np.int64], first: int) -> _Sums:
    return _Sums(
        array_in(plan, first, np.int64),
        array_in(plan, first + 1, np.int64),
        number_in(plan, first + 2),
        number_in(plan, first + 3),
        number_in(plan, first + 4),
        array_in(plan, first + 5, np.float32),
        array_in(plan, first + 6, np.int64),
    )


class _Scratch(NamedTuple):
    x: NDArray[np.float32]
    comparisons: NDArray[np.int64]
    memory: NDArray[np.int64]
    exits: NDArray[np.uint8]
    sums: NDArray[np.float32]


@inlined
def _read_scratch(plan: NDArray[np.int64], first: int) -> _Scratch:
    return _Scratch(
        array_in(plan, first, np.float32),
        array_in(plan, first + 1, np.int64),
        array_in(plan, first + 2, np.int64),
        array_in(plan, first + 3, np.uint8),
        array_in(plan, first + 4, np.float32),
    )


@dataclass(frozen=True)
class RowsForm:
    """A whole forest for blocks of rows; its trees have at most 65,536 leaves.

    Attributes:
        columns: the comparisons that its nodes make.
        narrow: the trees whose leaf numbers take a byte.
        wide: the others.
        most_numbers: leaf numbers of the largest tree.
        leaves: (trees,) LEAVES, output by output, in the forest's order within each.
        start: (outputs + 1,) int64, each output's first entry in `leaves`.
        tables: (bytes,) uint8, all leaf tables.
        places: exits that one output may need.
        base_score: (outputs,) float32.
    """

    columns: Columns
    narrow: RowsLayout
    wide: RowsLayout
    most_numbers: int
    leaves: NDArray[np.void]
    start: NDArray[np.int64]
    tables: NDArray[np.uint8]
    places: int
    base_score: NDArray[np.float32]

    @classmethod
    def of(cls, forest: Forest, index: InOrder) -> Self:
        """Lays a forest out."""
        columns = Columns.of(index, 16, np.arange(forest.trees))
        numbers = LeafNumbers.of(index, len(columns.cuts) <= _MOST_NARROW_COMPARISONS)
        small = numbers.small
        order = np.argsort(forest.outputs, kind="stable")
        start = np.searchsorted(forest.outputs[order], np.arange(len(forest.base_score) + 1))
        # Exits of two bytes take the room of two trees.
        ends = np.cumsum(np.where(small[order], 1, 2))
        begins = ends - np.where(small[order], 1, 2)
        places = np.empty(forest.trees, dtype=np.int64)
        places[order] = begins - np.append(begins, 0)[start[forest.outputs[order]]]
        most = int(places.max(initial=0)) + 2
        leaves = np.empty(forest.trees, dtype=LEAVES)
        leaves["exits"] = places[order]
        tables = write_leaf_tables(index, numbers, order, leaves)
        narrow, wide = (
            RowsLayout.of(index, numbers, columns, size, forest.outputs, places, most, len(start) - 1)
            for size in (1, 2)
        )
        tables, *records = together(tables, narrow.records, wide.records)
        narrow, wide = replace(narrow, records=records[0]), replace(wide, records=records[1])
        largest = int(numbers.count.max(initial=1))
        return cls(columns, narrow, wide, largest, leaves, start, tables, most + 2, forest.base_score)


class RowsKernel(CompiledKernel):
    """A RowsForm compiled for one block size."""

    def __init__(self, form: RowsForm, lanes: int, scales: Scales) -> None:
        self.lanes = lanes
        self.name = f"bitset-{lanes}"
        self._form = form
        layouts = (form.narrow, form.wide)
        sets = [split_sets(layout.full) for layout in layouts]
        self._kept = (scales, sets)
        self._parts = [
            _Part(
                layout.start,
                layout.groups.ctypes.data,
                layout.records.ctypes.data,
                2**layout.full - 1,
                each.ctypes.data,
                find_exits(layout.size, lanes) if len(layout.groups) else 0,
            )
            for layout, each in zip(layouts, sets, strict=True)
        ]
        lane = np.empty(lanes, dtype=np.int64)
        lane[assembled_lane(lanes)] = np.arange(lanes)
        self._sums = _Sums(
            form.start,
            np.append(form.leaves["table"], form.tables.nbytes)[form.start],
            form.leaves.ctypes.data,
            form.tables.ctypes.data,
            add_leaves(lanes),
            form.base_score,
            lane,
        )
        super().__init__(_evaluate, pack(form.columns.plain, *self._parts, self._sums, scales))

    def _scratch(self) -> Scratch:
        """Memory for one evaluation at a time."""
        return Scratch(
            _Scratch(
                np.empty(self.lanes, dtype=np.float32),
                # The last comparison is never made: no row goes right.
                np.zeros((len(self._form.columns.cuts) + 1) * self.lanes // 64, dtype=np.int64),
                np.zeros(memory_words(self._form.most_numbers), dtype=np.int64),
                np.empty(self._form.places * self.lanes, dtype=np.uint8),
                np.empty(self.lanes, dtype=np.float32),
            )
        )


@compiled
def _find_exits(part, output, sums, scratch):  # type: ignore[no-untyped-def]
    """Writes the exits of one output's trees, and asks for their leaf tables."""
    first, stop = part.group_start[output], part.group_start[output + 1]
    if first < stop:
        groups = part.groups + first * _GROUP
        comparisons, memory = scratch.comparisons.ctypes.data, scratch.memory.ctypes.data
        exits, tables = scratch.exits.ctypes.data, sums.tables + sums.table_start[output]
        # Long blocks spend so long on a table that the processor fetches the next one by itself.
        bytes_ = sums.table_start[output + 1] - sums.table_start[output] if sums.lane.size == 64 else 0
        given = (stop - first, groups, part.records, part.full, part.sets, comparisons, memory)
        call(part.traversal, (*given, exits, tables, bytes_ // (stop - first)))


_NARROW: Final = len(PlainColumns._fields)
_WIDE: Final = _NARROW + len(_Part._fields)
_SUMS: Final = _WIDE + len(_Part._fields)
_SCALES: Final = _SUMS + len(_Sums._fields)


@compiled
def _evaluate(plan, memory, windows, result):  # type: ignore[no-untyped-def]
    columns = read_columns(plan, 0)
    narrow, wide = _read_part(plan, _NARROW), _read_part(plan, _WIDE)
    sums, scales = _read_sums(plan, _SUMS), read_scales(plan, _SCALES)
    scratch = _read_scratch(memory, 0)
    lanes = sums.lane.size
    exits, totals = scratch.exits.ctypes.data, scratch.sums.ctypes.data
    for first in range(0, windows.shape[0], lanes):
        rows = min(lanes, windows.shape[0] - first)
        compare(columns, scales, windows, first, scratch.x, scratch.comparisons)
        for output in range(sums.base_score.size):
            _find_exits(narrow, output, sums, scratch)
            _find_exits(wide, output, sums, scratch)
            scratch.sums[:] = sums.base_score[output]
            count = sums.start[output + 1] - sums.start[output]
            leaves = sums.leaves + 16 * sums.start[output]
            call(sums.addition, (count, leaves, sums.tables, exits, totals, rows))
            for row in range(rows):
                result[first + row, output] = restore(scales, output, scratch.sums[sums.lane[row]])

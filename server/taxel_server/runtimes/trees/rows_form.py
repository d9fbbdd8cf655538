"""The form of a forest for many rows: blocks of rows go through all trees, then the leaves are summed."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numba
import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.calls import call
from taxel_server.runtimes.trees.columns import rank_column, ranking_at
from taxel_server.runtimes.trees.forest import Forest
from taxel_server.runtimes.trees.in_order import InOrder
from taxel_server.runtimes.trees.leaf_tables import LEAVES, write_leaf_tables
from taxel_server.runtimes.trees.lookups import assembled_lane
from taxel_server.runtimes.trees.plans import Scratch, array_at, pack
from taxel_server.runtimes.trees.rows_in_lanes import add_leaves, find_exits
from taxel_server.runtimes.trees.rows_layout import MOST_LEAVES, RowsLayout
from taxel_server.runtimes.trees.scales import Scales, scales_at


class _Part(NamedTuple):
    """The trees of one exit size."""

    group_start: NDArray[np.int64]
    groups: int
    records: int
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
    places: NDArray[np.int32]
    narrow_ranks: NDArray[np.int8]
    wide_ranks: NDArray[np.int16]
    exits: NDArray[np.uint8]
    sums: NDArray[np.float32]


@dataclass(frozen=True)
class RowsForm:
    """A whole forest for blocks of rows; its trees have at most 32,767 leaves.

    Attributes:
        narrow: the trees of at most 127 leaves.
        wide: the others.
        leaves: (trees,) LEAVES, output by output, in the forest's order within each.
        start: (outputs + 1,) int64, each output's first entry in `leaves`.
        tables: (bytes,) uint8, all leaf tables.
        places: exits that one output may need.
        base_score: (outputs,) float32.
    """

    narrow: RowsLayout
    wide: RowsLayout
    leaves: NDArray[np.void]
    start: NDArray[np.int64]
    tables: NDArray[np.uint8]
    places: int
    base_score: NDArray[np.float32]

    @classmethod
    def of(cls, forest: Forest, index: InOrder) -> Self:
        """Lays a forest out."""
        small = index.leaves <= MOST_LEAVES[8]
        order = np.argsort(forest.outputs, kind="stable")
        start = np.searchsorted(forest.outputs[order], np.arange(len(forest.base_score) + 1))
        # 16-bit exits take the room of two.
        ends = np.cumsum(np.where(small[order], 1, 2))
        begins = ends - np.where(small[order], 1, 2)
        places = np.empty(forest.trees, dtype=np.int64)
        places[order] = begins - np.append(begins, 0)[start[forest.outputs[order]]]
        most = int(places.max(initial=0)) + 2
        leaves = np.empty(forest.trees, dtype=LEAVES)
        leaves["exits"] = places[order]
        tables = write_leaf_tables(index, order, small[order], leaves)
        narrow, wide = (
            RowsLayout.of(index, bits, np.flatnonzero(chosen), forest.outputs, places, most, len(start) - 1)
            for bits, chosen in ((8, small), (16, ~small))
        )
        return cls(narrow, wide, leaves, start, tables, most + 2, forest.base_score)


class RowsKernel:
    """A RowsForm compiled for one block size; each thread needs a scratch of its own."""

    def __init__(self, form: RowsForm, lanes: int, scales: Scales) -> None:
        self.lanes = lanes
        self._form = form
        self._kept = scales
        self._parts = [
            _Part(
                layout.start,
                layout.groups.ctypes.data,
                layout.records.ctypes.data,
                find_exits(bits, lanes) if len(layout.groups) else 0,
            )
            for bits, layout in ((8, form.narrow), (16, form.wide))
        ]
        lane = np.empty(lanes, dtype=np.int64)
        lane[assembled_lane(lanes)] = np.arange(lanes)
        self._sums = _Sums(
            form.start,
            form.leaves.ctypes.data,
            form.tables.ctypes.data,
            add_leaves(lanes),
            form.base_score,
            lane,
        )
        self._plan = pack(
            form.narrow.columns.ranking, form.wide.columns.ranking, *self._parts, self._sums, scales
        )

    def scratch(self) -> Scratch:
        """Memory for one evaluation at a time."""
        return Scratch(
            _Scratch(
                np.empty(self.lanes, dtype=np.float32),
                np.empty(self.lanes, dtype=np.int32),
                np.empty(len(self._form.narrow.columns) * self.lanes, dtype=np.int8),
                np.empty(len(self._form.wide.columns) * self.lanes, dtype=np.int16),
                np.empty(self._form.places * self.lanes, dtype=np.uint8),
                np.empty(self.lanes, dtype=np.float32),
            )
        )

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32], scratch: Scratch) -> None:
        """Fills `result` (n, outputs) with what the forest says of `windows` (n, features)."""
        _evaluate(self._plan, scratch.plan, windows, result)


@numba.njit(cache=True, nogil=True)
def _rank_block(part, scales, windows, first, highest, scratch, ranks):  # type: ignore[no-untyped-def]
    """Ranks [column][lane], less half their range; lanes beyond the last row repeat it."""
    x, places = scratch.x, scratch.places
    feature = -1
    for column in range(part.feature.size):
        if feature != part.feature[column]:
            feature = part.feature[column]
            for lane in range(x.size):
                x[lane] = windows[min(first + lane, windows.shape[0] - 1), feature]
            if scales.applied:
                for lane in range(x.size):
                    x[lane] = (x[lane] - scales.input_mean[feature]) / scales.input_std[feature]
        cuts = part.cuts[part.start[column] : part.start[column + 1]]
        rank_column(x, cuts, part.default_left[column], highest, places)
        for lane in range(x.size):
            ranks[column * x.size + lane] = places[lane] - (highest + 1) // 2


@numba.njit(cache=True)
def _part_at(plan, entry):  # type: ignore[no-untyped-def]
    return _Part(
        array_at(plan, entry, np.int64), plan[entry + 1, 0], plan[entry + 2, 0], plan[entry + 3, 0]
    )


@numba.njit(cache=True)
def _sums_at(plan, entry):  # type: ignore[no-untyped-def]
    return _Sums(
        array_at(plan, entry, np.int64),
        plan[entry + 1, 0],
        plan[entry + 2, 0],
        plan[entry + 3, 0],
        array_at(plan, entry + 4, np.float32),
        array_at(plan, entry + 5, np.int64),
    )


@numba.njit(cache=True)
def _scratch_at(plan):  # type: ignore[no-untyped-def]
    return _Scratch(
        array_at(plan, 0, np.float32),
        array_at(plan, 1, np.int32),
        array_at(plan, 2, np.int8),
        array_at(plan, 3, np.int16),
        array_at(plan, 4, np.uint8),
        array_at(plan, 5, np.float32),
    )


@numba.njit(cache=True, nogil=True)
def _evaluate(plan, memory, windows, result):  # type: ignore[no-untyped-def]
    rank_narrow, rank_wide = ranking_at(plan, 0), ranking_at(plan, 4)
    narrow, wide, sums = _part_at(plan, 8), _part_at(plan, 12), _sums_at(plan, 16)
    scales, scratch = scales_at(plan, 22), _scratch_at(memory)
    lanes = sums.lane.size
    exits, totals = scratch.exits.ctypes.data, scratch.sums.ctypes.data
    for first in range(0, windows.shape[0], lanes):
        rows = min(lanes, windows.shape[0] - first)
        _rank_block(rank_narrow, scales, windows, first, 255, scratch, scratch.narrow_ranks)
        _rank_block(rank_wide, scales, windows, first, 65535, scratch, scratch.wide_ranks)
        for output in range(sums.base_score.size):
            count = narrow.group_start[output + 1] - narrow.group_start[output]
            groups = narrow.groups + narrow.group_start[output] * 48
            if count:
                call(
                    narrow.traversal, count, groups, narrow.records, scratch.narrow_ranks.ctypes.data, exits
                )
            count = wide.group_start[output + 1] - wide.group_start[output]
            groups = wide.groups + wide.group_start[output] * 48
            if count:
                call(wide.traversal, count, groups, wide.records, scratch.wide_ranks.ctypes.data, exits)
            scratch.sums[:] = sums.base_score[output]
            count = sums.start[output + 1] - sums.start[output]
            call(sums.addition, count, sums.leaves + 16 * sums.start[output], sums.tables, exits, totals)
            for row in range(rows):
                value = scratch.sums[sums.lane[row]]
                if scales.applied:
                    value = value * scales.output_std[output] + scales.output_mean[output]
                result[first + row, output] = value

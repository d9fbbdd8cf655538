"""Evaluates a small batch of rows: first whole trees side by side, then the leaves of all rows."""

from dataclasses import replace
from itertools import pairwise
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import array_in, number_in, together
from taxel_server.runtimes.compiled.compiling import compiled, inlined
from taxel_server.runtimes.compiled.evaluator import CompiledEvaluator
from taxel_server.runtimes.compiled.processor import register_bytes
from taxel_server.runtimes.compiled.vectors import call
from taxel_server.runtimes.trees.few_rows.kernels import (
    ROWS,
    add_leaves,
    find_exits,
    padded_cuts,
    put_exits,
    rank_rows,
    trees_at_once,
)
from taxel_server.runtimes.trees.layout.columns import Columns, Cuts, read_cuts
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.layout.tree_lanes import MOST_EXITS, TopTrees, table_size
from taxel_server.runtimes.trees.normalisation import Scales, put_rows, read_scales
from taxel_server.runtimes.trees.reading.forest import Forest
from taxel_server.runtimes.trees.simd.lookups import interleaved_lane
from taxel_server.runtimes.trees.switches import Switches, waits_for_memory

_BATCH: Final = 2800
"""The fewest trees of a batch. All its exits are found before its leaves are added; it fits the cache."""


class SmallBatchForest(NamedTuple):
    """A forest laid out for a small batch of rows.

    Attributes:
        cuts: of its columns.
        size: of a table.
        top: whole trees, in groups.
        batch_group, batch_output: (batches + 1,) the first group, and the first output, of each batch.
        output_tree, output_leaf: (outputs + 1,) the first tree, and the first leaf, of each output.
        slots: (places,) where a lane's exits go in its batch.
        spare: the slot of lanes without a tree.
        counts: (trees,) leaves of each tree.
        leaves: the values of all leaves, and room for an exit behind the last.
        lanes: of a group.
        next_nodes, next_leaves: as in `Switches`.
        base_score: (outputs,) float32.
    """

    cuts: Cuts
    size: int
    top: TopTrees
    batch_group: NDArray[np.int64]
    batch_output: NDArray[np.int64]
    output_tree: NDArray[np.int64]
    output_leaf: NDArray[np.int64]
    slots: NDArray[np.int32]
    spare: int
    counts: NDArray[np.uint8]
    leaves: NDArray[np.float32]
    lanes: int
    next_nodes: bool
    next_leaves: bool
    base_score: NDArray[np.float32]

    @classmethod
    def of(cls, forest: Forest, index: InOrder, columns: Columns, switches: Switches) -> Self:
        """Lays a forest out that `fits`."""
        lanes = trees_at_once()
        order, output_tree = forest.by_output
        batch_output = _batches(output_tree)
        bounds = output_tree[batch_output]
        places, batch_group = _places(index.leaves[order], bounds, lanes)
        trees = np.where(places >= 0, order[places], -1).reshape(-1, lanes)
        counts = index.leaves[order]
        source = np.repeat(index.leaf_start[order] - (np.cumsum(counts) - counts), counts)
        # A call with fewer rows leaves exits of an earlier call in place: these may point behind a tree.
        leaves = np.append(index.value[source + np.arange(len(source))], np.zeros(256, dtype=np.float32))
        # A tree's slot is its place in the batch. Other lanes have the slot behind the largest batch.
        spare = int(np.diff(bounds).max(initial=0))
        slots = np.where(places >= 0, places - np.repeat(bounds[:-1], np.diff(batch_group) * lanes), spare)
        slots = slots.reshape(-1, register_bytes())[:, interleaved_lane(register_bytes())].astype(np.int32)
        return cls(
            padded_cuts(columns),
            table_size(columns),
            TopTrees.of(index, columns, trees, 1, switches.packed_nodes and waits_for_memory()),
            batch_group,
            batch_output,
            output_tree,
            np.append(0, np.cumsum(index.leaves[order]))[output_tree],
            slots,
            spare,
            counts.astype(np.uint8),
            leaves,
            lanes,
            switches.next_nodes,
            switches.next_leaves,
            forest.base_score,
        )

    @staticmethod
    def fits(index: InOrder) -> bool:
        """Whether no tree has more leaves than exits can number."""
        return bool(index.leaves.max(initial=1) <= MOST_EXITS[8])

    def placed(self) -> Self:
        """The same forest, its arrays at the start of cache lines."""
        cuts, nodes, counts, slots, leaves = together(
            self.cuts.cuts, self.top.nodes, self.counts, self.slots, self.leaves
        )
        cuts_of_columns, top = self.cuts._replace(cuts=cuts), replace(self.top, nodes=nodes)
        return self._replace(cuts=cuts_of_columns, top=top, counts=counts, slots=slots, leaves=leaves)


class _Trees(NamedTuple):
    """A laid out forest by batches of outputs, and the functions that evaluate it."""

    traversal: int
    ordering: int
    addition: int
    batch_group: NDArray[np.int64]
    batch_output: NDArray[np.int64]
    output_tree: NDArray[np.int64]
    output_leaf: NDArray[np.int64]
    steps: NDArray[np.int64]
    start: NDArray[np.int64]
    nodes: int
    slots: int
    counts: int
    leaves: int
    lanes: int
    ranks: int
    base_score: NDArray[np.float32]


@inlined
def _read_trees(arguments: NDArray[np.int64], first: int) -> _Trees:
    return _Trees(
        number_in(arguments, first),
        number_in(arguments, first + 1),
        number_in(arguments, first + 2),
        array_in(arguments, first + 3, np.int64),
        array_in(arguments, first + 4, np.int64),
        array_in(arguments, first + 5, np.int64),
        array_in(arguments, first + 6, np.int64),
        array_in(arguments, first + 7, np.int64),
        array_in(arguments, first + 8, np.int64),
        number_in(arguments, first + 9),
        number_in(arguments, first + 10),
        number_in(arguments, first + 11),
        number_in(arguments, first + 12),
        number_in(arguments, first + 13),
        number_in(arguments, first + 14),
        array_in(arguments, first + 15, np.float32),
    )


class _Scratch(NamedTuple):
    ranks: NDArray[np.int8]
    exits: NDArray[np.uint8]
    memory: NDArray[np.int64]
    by_slot: NDArray[np.int64]
    sums: NDArray[np.float32]


@inlined
def _read_scratch(arguments: NDArray[np.int64], first: int) -> _Scratch:
    return _Scratch(
        array_in(arguments, first, np.int8),
        array_in(arguments, first + 1, np.uint8),
        array_in(arguments, first + 2, np.int64),
        array_in(arguments, first + 3, np.int64),
        array_in(arguments, first + 4, np.float32),
    )


class SmallBatchEvaluator(CompiledEvaluator):
    """A forest compiled for a small batch of rows."""

    name = "small-batch"

    def __init__(self, forest: SmallBatchForest, scales: Scales) -> None:
        forest = forest.placed()
        top = forest.top
        trees = _Trees(
            find_exits(forest.size, top.bits, top.packed, forest.next_nodes),
            put_exits(),
            add_leaves(forest.next_leaves),
            forest.batch_group,
            forest.batch_output,
            forest.output_tree,
            forest.output_leaf,
            top.steps,
            top.start,
            top.nodes.ctypes.data,
            forest.slots.ctypes.data,
            forest.counts.ctypes.data,
            forest.leaves.ctypes.data,
            forest.lanes,
            forest.size,
            forest.base_score,
        )
        scratch = _Scratch(
            np.zeros(ROWS * forest.size, dtype=np.int8),
            np.zeros(ROWS * forest.lanes, dtype=np.uint8),
            np.zeros(forest.lanes, dtype=np.int64),
            np.zeros(forest.spare + 1, dtype=np.int64),
            np.zeros(ROWS * len(forest.base_score), dtype=np.float32),
        )
        super().__init__((forest, scales), _evaluate, (forest.cuts, trees, scales), scratch)


def _batches(output_tree: NDArray[np.int64]) -> NDArray[np.int64]:
    """(batches + 1,) The first output of each batch."""
    starts = [0]
    for output in range(1, len(output_tree)):
        if output_tree[output] - output_tree[starts[-1]] >= _BATCH or output == len(output_tree) - 1:
            starts.append(output)
    return np.array(starts)


def _places(
    leaves: NDArray[np.int64], bounds: NDArray[np.int64], lanes: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The place of each lane's tree, or -1, and each batch's first group. Trees are sorted by size."""
    places, groups = [], [0]
    for first, stop in pairwise(bounds):
        count = -(-(stop - first) // lanes)
        batch = np.full(count * lanes, -1, dtype=np.int64)
        batch[: stop - first] = first + np.argsort(leaves[first:stop], kind="stable")
        places.append(batch)
        groups.append(groups[-1] + count)
    return np.concatenate(places), np.array(groups)


@compiled
def _visit(trees: _Trees, scratch: _Scratch, rows: int) -> None:
    """Adds every tree's leaf to the sums [output][row], batch after batch."""
    ranks, exits, sums = scratch.ranks.ctypes.data, scratch.exits.ctypes.data, scratch.sums.ctypes.data
    memory, by_slot = scratch.memory.ctypes.data, scratch.by_slot.ctypes.data
    for batch in range(trees.batch_group.size - 1):
        first_output, stop_output = trees.batch_output[batch], trees.batch_output[batch + 1]
        first_group, stop_group = trees.batch_group[batch], trees.batch_group[batch + 1]
        # While a batch's trees are visited, each group prefetches an equal share of its leaves.
        wanted, stop_wanted = trees.output_leaf[first_output], trees.output_leaf[stop_output]
        share = (stop_wanted - wanted) // max(1, stop_group - first_group)
        for group in range(first_group, stop_group):
            nodes = trees.nodes + trees.start[group]
            later = trees.leaves + 4 * (wanted + share * (group - first_group))
            call(trees.traversal, (nodes, trees.steps[group], ranks, rows, exits, later))
            call(trees.ordering, (exits, trees.slots + 4 * group * trees.lanes, memory, by_slot))
        base = trees.output_tree[first_output]
        for output in range(first_output, stop_output):
            tree, stop = trees.output_tree[output], trees.output_tree[output + 1]
            leaf, stop_leaf = trees.output_leaf[output], trees.output_leaf[output + 1]
            given = (stop - tree, trees.counts + tree, trees.leaves + 4 * leaf, by_slot + 8 * (tree - base))
            lines = -(-(stop_leaf - leaf) // (16 * max(1, stop - tree)))
            call(trees.addition, (*given, sums + 4 * ROWS * output, lines))


_TREES: Final = len(Cuts._fields)
_SCALES: Final = _TREES + len(_Trees._fields)


@compiled
def _evaluate(
    arguments: NDArray[np.int64],
    memory: NDArray[np.int64],
    windows: NDArray[np.float32],
    result: NDArray[np.float32],
) -> None:
    cuts = read_cuts(arguments, 0)
    trees, scales = _read_trees(arguments, _TREES), read_scales(arguments, _SCALES)
    scratch = _read_scratch(memory, 0)
    for start in range(0, windows.shape[0], ROWS):
        rows = min(ROWS, windows.shape[0] - start)
        rank_rows(cuts, scales, windows, start, rows, trees.ranks, scratch.ranks)
        for output in range(trees.base_score.size):
            scratch.sums[output * ROWS : (output + 1) * ROWS] = trees.base_score[output]
        _visit(trees, scratch, rows)
        put_rows(scales, scratch.sums, 1, ROWS, start, rows, result)

"""Evaluates a row or two: the top trees side by side, then one leaf block of every tree."""

from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import array_in, number_in, together
from taxel_server.runtimes.compiled.compiling import compiled, inlined
from taxel_server.runtimes.compiled.evaluator import CompiledEvaluator
from taxel_server.runtimes.compiled.vectors import call, prefetch
from taxel_server.runtimes.trees.few_rows.kernels import (
    OUTPUTS_AT_ONCE,
    ROWS,
    add_blocks,
    find_blocks,
    find_exits,
    padded_cuts,
    rank_rows,
    trees_at_once,
)
from taxel_server.runtimes.trees.layout.columns import Columns, Cuts, read_cuts
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.layout.tree_lanes import (
    BLOCK_LEAVES,
    LINE,
    MOST_EXITS,
    LeafBlocks,
    TopTrees,
    count_blocks,
    table_size,
)
from taxel_server.runtimes.trees.normalisation import Scales, put_rows, read_scales
from taxel_server.runtimes.trees.reading.forest import Forest
from taxel_server.runtimes.trees.switches import Switches, waits_for_memory

_MOST_BYTES: Final = 2**27
"""The most memory that top trees may take, and that lines for places without a tree may take."""


@dataclass(frozen=True)
class Groups:
    """How a forest's trees are divided into groups of lanes: each group holds whole rounds.

    A round is one tree of each output.

    Attributes:
        count: the number of groups.
        rounds: the rounds of a group.
        outputs: of the forest, at most one for each lane.
    """

    count: int
    rounds: int
    outputs: int

    @classmethod
    def of(cls, forest: Forest) -> Self:
        """Divides a forest's trees."""
        outputs = len(forest.base_score)
        rounds = trees_at_once() // outputs
        return cls(-(-int(forest.rounds.max(initial=-1) + 1) // rounds), rounds, outputs)

    def trees(self, forest: Forest) -> NDArray[np.int64]:
        """(groups, lanes) The number of the tree at each place, or -1."""
        trees = np.full((self.count, trees_at_once()), -1, dtype=np.int64)
        group, round_ = np.divmod(forest.rounds, self.rounds)
        trees[group, round_ * self.outputs + forest.outputs] = np.arange(forest.trees)
        return trees


class LeafBlocksForest(NamedTuple):
    """A forest laid out for one or two rows.

    Attributes:
        cuts: of its columns.
        size: of a table.
        top: the top trees.
        counts: (groups, lanes) the number of each tree's blocks.
        blocks: the leaf blocks.
        groups: of lanes.
        lanes: of a group.
        next_nodes, next_leaves: as in `Switches`.
        base_score: (outputs,) float32.
    """

    cuts: Cuts
    size: int
    top: TopTrees
    counts: NDArray[np.unsignedinteger[Any]]
    blocks: LeafBlocks
    groups: Groups
    lanes: int
    next_nodes: bool
    next_leaves: bool
    base_score: NDArray[np.float32]

    @classmethod
    def of(cls, forest: Forest, index: InOrder, columns: Columns, switches: Switches) -> Self:
        """Lays a forest out that `fits`."""
        groups = Groups.of(forest)
        trees = groups.trees(forest)
        top = TopTrees.of(index, columns, trees, BLOCK_LEAVES, switches.packed_nodes and waits_for_memory())
        blocks = LeafBlocks.of(index, columns, trees)
        return cls(
            padded_cuts(columns),
            table_size(columns),
            top,
            blocks.counts.astype(f"u{top.bits // 8}"),
            blocks,
            groups,
            trees.shape[1],
            switches.next_nodes and waits_for_memory(),
            switches.next_leaves,
            forest.base_score,
        )

    @staticmethod
    def fits(forest: Forest, index: InOrder) -> bool:
        """Whether every output has a lane, no tree has too many blocks, and the layout fits the memory.

        Every top tree takes the memory of the largest one in its group, so a few huge trees could fill the
        memory. In a forest with many trees for one output, places without a tree could fill it, too.
        """
        if len(forest.base_score) > trees_at_once():
            return False
        blocks = int(count_blocks(index, BLOCK_LEAVES).max(initial=1))
        places = Groups.of(forest).count * trees_at_once()
        return blocks <= MOST_EXITS[16] and (4 * blocks + LINE) * places <= _MOST_BYTES

    def placed(self) -> Self:
        """The same forest, its arrays at the start of cache lines."""
        cuts, nodes, counts, lines = together(
            self.cuts.cuts, self.top.nodes, self.counts, self.blocks.lines
        )
        return self._replace(
            cuts=self.cuts._replace(cuts=cuts),
            top=replace(self.top, nodes=nodes),
            counts=counts,
            blocks=replace(self.blocks, lines=lines),
        )


class _Trees(NamedTuple):
    """A laid out forest, and the functions that evaluate it."""

    traversal: int
    finding: int
    addition: int
    steps: NDArray[np.int64]
    start: NDArray[np.int64]
    first: NDArray[np.int64]
    prefetches: bool
    nodes: int
    counts: int
    size: int
    lanes: int
    rounds: int
    outputs: int
    ranks: int
    width: int
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
        number_in(arguments, first + 6) != 0,
        number_in(arguments, first + 7),
        number_in(arguments, first + 8),
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
    exits: NDArray[np.uint16]
    first: NDArray[np.int64]
    places: NDArray[np.int64]
    ahead: NDArray[np.int64]
    leaves: NDArray[np.float32]
    sums: NDArray[np.float32]


@inlined
def _read_scratch(arguments: NDArray[np.int64], first: int) -> _Scratch:
    return _Scratch(
        array_in(arguments, first, np.int8),
        array_in(arguments, first + 1, np.uint16),
        array_in(arguments, first + 2, np.int64),
        array_in(arguments, first + 3, np.int64),
        array_in(arguments, first + 4, np.int64),
        array_in(arguments, first + 5, np.float32),
        array_in(arguments, first + 6, np.float32),
    )


class LeafBlocksEvaluator(CompiledEvaluator):
    """A forest compiled for one or two rows."""

    name = "leaf-blocks"

    def __init__(self, forest: LeafBlocksForest, scales: Scales) -> None:
        forest = forest.placed()
        top, groups = forest.top, forest.groups
        trees = _Trees(
            find_exits(forest.size, top.bits, top.packed, prefetches=False),
            find_blocks(top.bits),
            add_blocks(forest.size, forest.next_leaves),
            top.steps,
            top.start,
            forest.blocks.lines.ctypes.data + LINE * forest.blocks.first,
            forest.next_nodes,
            top.nodes.ctypes.data,
            forest.counts.ctypes.data,
            top.bits // 8,
            forest.lanes,
            groups.rounds,
            groups.outputs,
            forest.size,
            -(-groups.outputs // OUTPUTS_AT_ONCE) * OUTPUTS_AT_ONCE,
            forest.base_score,
        )
        places = ROWS * forest.lanes
        scratch = _Scratch(
            np.zeros(ROWS * forest.size, dtype=np.int8),
            np.zeros(places, dtype=np.uint16),
            np.zeros(forest.lanes, dtype=np.int64),
            np.zeros(places, dtype=np.int64),
            np.zeros(places, dtype=np.int64),
            np.zeros(places + OUTPUTS_AT_ONCE, dtype=np.float32),
            np.zeros(ROWS * trees.width, dtype=np.float32),
        )
        super().__init__((forest, scales), _evaluate, (forest.cuts, trees, scales), scratch)


@compiled
def _visit(trees: _Trees, scratch: _Scratch, rows: int) -> None:
    """Adds every tree's leaf to the sums. A group's top trees come before the last group's blocks."""
    ranks, sums, exits = scratch.ranks.ctypes.data, scratch.sums.ctypes.data, scratch.exits.ctypes.data
    first, places, ahead = scratch.first.ctypes.data, scratch.places.ctypes.data, scratch.ahead.ctypes.data
    leaves, width = scratch.leaves.ctypes.data, 4 * trees.width
    for lane in range(trees.lanes):
        scratch.first[lane] = trees.first[lane]
    for group in range(trees.steps.size + 1):
        if group < trees.steps.size:
            nodes, size = trees.nodes + trees.start[group], trees.start[group + 1] - trees.start[group]
            if trees.prefetches:
                for soon in range(nodes + size, nodes + 2 * size, 64):
                    prefetch(soon, 1)
            call(trees.traversal, (nodes, trees.steps[group], ranks, rows, exits, 0))
            counts = trees.counts + trees.size * group * trees.lanes
            call(trees.finding, (first, counts, rows, exits, ahead))
        if group:
            given = (ranks, rows, places, ahead, leaves, trees.rounds, trees.outputs, sums, width)
            call(trees.addition, given)
        places, ahead = ahead, places


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
    outputs = trees.base_score.size
    for start in range(0, windows.shape[0], ROWS):
        rows = min(ROWS, windows.shape[0] - start)
        rank_rows(cuts, scales, windows, start, rows, trees.ranks, scratch.ranks)
        for row in range(rows):
            for output in range(outputs):
                scratch.sums[row * trees.width + output] = trees.base_score[output]
        _visit(trees, scratch, rows)
        put_rows(scales, scratch.sums, trees.width, 1, start, rows, result)

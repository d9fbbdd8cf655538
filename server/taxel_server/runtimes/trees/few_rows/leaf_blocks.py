"""The form of a forest for a row or two: trunks side by side, then one twig of every tree."""

from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import Scratch, array_in, number_in, pack, together
from taxel_server.runtimes.compiled.compiling import compiled, inlined
from taxel_server.runtimes.compiled.kernel import CompiledKernel
from taxel_server.runtimes.trees.few_rows.ranks import ROWS, Ranking, rank_rows, read_ranking
from taxel_server.runtimes.trees.few_rows.tree_lanes import (
    OUTPUTS_AT_ONCE,
    add_twigs,
    find_exits,
    find_twigs,
    trees_at_once,
)
from taxel_server.runtimes.trees.layout.columns import Columns
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.layout.tree_lanes import (
    LINE,
    MOST_TWIGS,
    TWIG,
    TrunksLayout,
    TwigsLayout,
    count_twigs,
    table_size,
)
from taxel_server.runtimes.trees.normalisation import Scales, put_rows, read_scales
from taxel_server.runtimes.trees.reading.forest import Forest
from taxel_server.runtimes.trees.simd.calls import call

_MOST_BYTES: Final = 2**27
"""Most memory that trunks, and lines for places without a tree, may take."""


@dataclass(frozen=True)
class _Groups:
    """How a forest's trees go into groups of lanes: whole rounds, a tree of each output, or parts of one.

    Attributes:
        count: groups.
        rounds: of a group.
        outputs: of a group, the next ones in every part of a round.
        parts: groups that a round takes.
    """

    count: int
    rounds: int
    outputs: int
    parts: int

    @classmethod
    def of(cls, forest: Forest) -> Self:
        every, lanes = len(forest.base_score), trees_at_once()
        outputs, parts = min(every, lanes), -(-every // lanes)
        rounds = lanes // outputs
        return cls(-(-int(forest.rounds.max(initial=-1) + 1) // rounds) * parts, rounds, outputs, parts)

    def trees(self, forest: Forest) -> NDArray[np.int64]:
        """(groups, lanes) The number of the tree at each place, or -1."""
        trees = np.full((self.count, trees_at_once()), -1, dtype=np.int64)
        part, output = np.divmod(forest.outputs, self.outputs)
        group, round_ = np.divmod(forest.rounds, self.rounds)
        trees[group * self.parts + part, round_ * self.outputs + output] = np.arange(forest.trees)
        return trees


class _Trees(NamedTuple):
    """A laid out forest, and the functions that evaluate it."""

    traversal: int
    finding: int
    addition: int
    steps: NDArray[np.int64]
    start: NDArray[np.int64]
    first: NDArray[np.int64]
    nodes: int
    counts: int
    size: int
    lanes: int
    rounds: int
    outputs: int
    parts: int
    ranks: int
    width: int
    base_score: NDArray[np.float32]


@inlined
def _read_trees(plan: NDArray[np.int64], first: int) -> _Trees:
    return _Trees(
        number_in(plan, first),
        number_in(plan, first + 1),
        number_in(plan, first + 2),
        array_in(plan, first + 3, np.int64),
        array_in(plan, first + 4, np.int64),
        array_in(plan, first + 5, np.int64),
        number_in(plan, first + 6),
        number_in(plan, first + 7),
        number_in(plan, first + 8),
        number_in(plan, first + 9),
        number_in(plan, first + 10),
        number_in(plan, first + 11),
        number_in(plan, first + 12),
        number_in(plan, first + 13),
        number_in(plan, first + 14),
        array_in(plan, first + 15, np.float32),
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
def _read_scratch(plan: NDArray[np.int64], first: int) -> _Scratch:
    return _Scratch(
        array_in(plan, first, np.int8),
        array_in(plan, first + 1, np.uint16),
        array_in(plan, first + 2, np.int64),
        array_in(plan, first + 3, np.int64),
        array_in(plan, first + 4, np.int64),
        array_in(plan, first + 5, np.float32),
        array_in(plan, first + 6, np.float32),
    )


class TwigsKernel(CompiledKernel):
    """A forest that `fits`, compiled for a row or two."""

    name = "leaf-blocks"

    def __init__(self, forest: Forest, index: InOrder, columns: Columns, scales: Scales) -> None:
        size = table_size(columns)
        groups = _Groups.of(forest)
        trees = groups.trees(forest)
        trunks = TrunksLayout.of(index, columns, trees, TWIG)
        twigs = TwigsLayout.of(index, columns, trees)
        counts = twigs.counts.astype(f"u{trunks.bits // 8}")
        nodes, counts, lines = together(trunks.nodes, counts, twigs.lines)
        self._trees = _Trees(
            find_exits(size, trunks.bits, trunks.packed),
            find_twigs(trunks.bits),
            add_twigs(size),
            trunks.steps,
            trunks.start,
            lines.ctypes.data + LINE * twigs.first,
            nodes.ctypes.data,
            counts.ctypes.data,
            trunks.bits // 8,
            trees.shape[1],
            groups.rounds,
            groups.outputs,
            groups.parts,
            size,
            -(-groups.parts * groups.outputs // OUTPUTS_AT_ONCE) * OUTPUTS_AT_ONCE,
            forest.base_score,
        )
        ranking = Ranking.of(columns)
        self._kept = (ranking, nodes, counts, lines, scales)
        super().__init__(_evaluate, pack(ranking, self._trees, scales))

    @staticmethod
    def fits(forest: Forest, index: InOrder) -> bool:
        """Whether no tree has too many twigs, for trees that can stand side by side.

        A group's trunks take the room of its largest one, so that a few huge trees could fill the memory,
        and so could the places without a tree of a forest with many trees for one output.
        """
        twigs = int(count_twigs(index, TWIG).max(initial=1))
        places = _Groups.of(forest).count * trees_at_once()
        return twigs <= MOST_TWIGS[16] and (4 * twigs + LINE) * places <= _MOST_BYTES

    def _scratch(self) -> Scratch:
        """Memory for one evaluation at a time."""
        own = _Scratch(
            np.zeros(ROWS * self._trees.ranks, dtype=np.int8),
            np.zeros(ROWS * self._trees.lanes, dtype=np.uint16),
            np.zeros(self._trees.lanes, dtype=np.int64),
            np.zeros(ROWS * self._trees.lanes, dtype=np.int64),
            np.zeros(ROWS * self._trees.lanes, dtype=np.int64),
            np.zeros(ROWS * self._trees.lanes + OUTPUTS_AT_ONCE, dtype=np.float32),
            np.empty(ROWS * self._trees.width, dtype=np.float32),
        )
        return Scratch(own)


@compiled
def _visit(trees, scratch, rows):  # type: ignore[no-untyped-def]
    """Adds every tree's leaf to the sums; a group's trunks go before the twigs of the group before it."""
    ranks, sums, exits = scratch.ranks.ctypes.data, scratch.sums.ctypes.data, scratch.exits.ctypes.data
    first, places, ahead = scratch.first.ctypes.data, scratch.places.ctypes.data, scratch.ahead.ctypes.data
    leaves, width = scratch.leaves.ctypes.data, 4 * trees.width
    for lane in range(trees.lanes):
        scratch.first[lane] = trees.first[lane]
    for group in range(trees.steps.size + 1):
        if group < trees.steps.size:
            nodes = trees.nodes + trees.start[group]
            call(trees.traversal, (nodes, trees.steps[group], ranks, rows, exits, 0, 0))
            counts = trees.counts + trees.size * group * trees.lanes
            call(trees.finding, (first, counts, rows, exits, ahead))
        if group:
            totals = sums + 4 * trees.outputs * ((group - 1) % trees.parts)
            given = (ranks, rows, places, ahead, leaves, trees.rounds, trees.outputs, totals, width)
            call(trees.addition, given)
        places, ahead = ahead, places


_TREES: Final = len(Ranking._fields)
_SCALES: Final = _TREES + len(_Trees._fields)


@compiled
def _evaluate(plan, memory, windows, result):  # type: ignore[no-untyped-def]
    ranking = read_ranking(plan, 0)
    trees, scales = _read_trees(plan, _TREES), read_scales(plan, _SCALES)
    scratch = _read_scratch(memory, 0)
    outputs = trees.base_score.size
    for start in range(0, windows.shape[0], ROWS):
        rows = min(ROWS, windows.shape[0] - start)
        rank_rows(ranking, scales, windows, start, rows, 255, 128, trees.ranks, scratch.ranks)
        for row in range(rows):
            for output in range(outputs):
                scratch.sums[row * trees.width + output] = trees.base_score[output]
        _visit(trees, scratch, rows)
        put_rows(scales, scratch.sums, trees.width, 1, start, rows, result)

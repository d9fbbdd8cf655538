"""The form of a forest for few rows of large trees: many walks from node to node, in turn."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.arguments import Scratch, array_in, number_in, pack
from taxel_server.runtimes.compiled.compiling import compiled, inlined
from taxel_server.runtimes.compiled.kernel import CompiledKernel
from taxel_server.runtimes.compiled.vectors import integer_at
from taxel_server.runtimes.trees.few_rows.ranks import ROWS, Ranking, rank_rows, read_ranking
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.layout.linked_nodes import LinkedLayout
from taxel_server.runtimes.trees.normalisation import Scales, put_rows, read_scales
from taxel_server.runtimes.trees.reading.forest import Forest

_WALKERS: Final = 16
"""Walks that advance in turn, so that one need not wait for another's memory."""


class _Trees(NamedTuple):
    root: NDArray[np.int64]
    output: NDArray[np.int32]
    nodes: int
    value: NDArray[np.float32]
    ranks: int
    base_score: NDArray[np.float32]


@inlined
def _read_trees(plan: NDArray[np.int64], first: int) -> _Trees:
    return _Trees(
        array_in(plan, first, np.int64),
        array_in(plan, first + 1, np.int32),
        number_in(plan, first + 2),
        array_in(plan, first + 3, np.float32),
        number_in(plan, first + 4),
        array_in(plan, first + 5, np.float32),
    )


class _Scratch(NamedTuple):
    ranks: NDArray[np.uint16]
    sums: NDArray[np.float32]
    walkers: NDArray[np.int64]


@inlined
def _read_scratch(plan: NDArray[np.int64], first: int) -> _Scratch:
    return _Scratch(
        array_in(plan, first, np.uint16),
        array_in(plan, first + 1, np.float32),
        array_in(plan, first + 2, np.int64),
    )


class LinkedKernel(CompiledKernel):
    """A forest of any size, to be walked."""

    name = "node-walk"

    def __init__(self, forest: Forest, index: InOrder, scales: Scales) -> None:
        layout = LinkedLayout.of(forest, index)
        columns = layout.columns
        self._trees = _Trees(
            forest.roots[:-1],
            forest.outputs,
            layout.nodes.ctypes.data,
            layout.value,
            len(columns) + 1,
            forest.base_score,
        )
        ranking = Ranking.of(columns)
        self._kept = (ranking, layout, scales)
        super().__init__(_evaluate, pack(ranking, self._trees, scales))

    def _scratch(self) -> Scratch:
        """Memory for one evaluation at a time."""
        own = _Scratch(
            np.zeros(ROWS * self._trees.ranks, dtype=np.uint16),
            np.empty(ROWS * len(self._trees.base_score), dtype=np.float32),
            np.empty(2 * _WALKERS, dtype=np.int64),
        )
        return Scratch(own)


@compiled
def _walk(trees, scratch, rows):  # type: ignore[no-untyped-def]
    """Every tree with every row is a walk; they advance together, in handfuls, until none moves."""
    walks, outputs = trees.root.size * rows, trees.base_score.size
    place, ranks = scratch.walkers[:_WALKERS], scratch.walkers[_WALKERS:]
    base = scratch.ranks.ctypes.data
    for first in range(0, walks, _WALKERS):
        count = min(_WALKERS, walks - first)
        for walker in range(count):
            tree, row = divmod(first + walker, rows)
            place[walker] = trees.root[tree]
            ranks[walker] = base + 2 * row * trees.ranks
        moving = True
        while moving:
            moving = False
            for walker in range(count):
                node = trees.nodes + 8 * place[walker]
                rank = integer_at(ranks[walker] + 2 * integer_at(node, 16), 16)
                after = integer_at(node + 4, 32) + (rank >= integer_at(node + 2, 16))
                moving |= after != place[walker]
                place[walker] = after
        for walker in range(count):
            tree, row = divmod(first + walker, rows)
            scratch.sums[row * outputs + trees.output[tree]] += trees.value[place[walker]]


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
        rank_rows(ranking, scales, windows, start, rows, 65535, 0, trees.ranks, scratch.ranks)
        for row in range(rows):
            for output in range(outputs):
                scratch.sums[row * outputs + output] = trees.base_score[output]
        _walk(trees, scratch, rows)
        put_rows(scales, scratch.sums, outputs, 1, start, rows, result)

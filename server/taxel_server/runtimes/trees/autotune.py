"""Autotuning: a load times all evaluators of a forest and chooses one for each number of rows."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.evaluator import Evaluator
from taxel_server.runtimes.timing import least_seconds
from taxel_server.runtimes.trees.few_rows.kernels import ROWS
from taxel_server.runtimes.trees.few_rows.leaf_blocks import LeafBlocksEvaluator, LeafBlocksForest
from taxel_server.runtimes.trees.few_rows.small_batch import SmallBatchEvaluator, SmallBatchForest
from taxel_server.runtimes.trees.layout.bitsets import MOST_LEAVES
from taxel_server.runtimes.trees.layout.columns import Columns
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.layout.tree_lanes import fits_lanes
from taxel_server.runtimes.trees.many_rows.bitset import BitsetEvaluator, BitsetForest
from taxel_server.runtimes.trees.node_walk import NodeWalkEvaluator, walk
from taxel_server.runtimes.trees.normalisation import Scales
from taxel_server.runtimes.trees.reading.forest import Forest
from taxel_server.runtimes.trees.switches import ALL_ON, Switches

BLOCKS: Final = (64, 256)
"""Rows of a block: a short block wastes fewer lanes, a long one reads the forest less often."""

_LOG: Final = logging.getLogger(__name__)


@dataclass(frozen=True)
class Timed:
    """An evaluator and its times.

    Attributes:
        evaluator: what was timed.
        size: rows of a block, which it evaluates at once.
        row_seconds: the time of one row.
        block_seconds: the time of a block.
    """

    evaluator: Evaluator
    size: int
    row_seconds: float
    block_seconds: float

    def seconds(self, rows: int) -> float:
        """The estimated time of some rows; a part of a block is interpolated."""
        blocks, left = divmod(rows, self.size)
        each = (self.block_seconds - self.row_seconds) / max(self.size - 1, 1)
        return blocks * self.block_seconds + (self.row_seconds + each * (left - 1) if left else 0.0)


class Autotuned:
    """A forest with every evaluator that fits it, and the fastest one for each number of rows.

    Attributes:
        evaluators: all that fit.
        cheapest: entry n evaluates n rows; the last entry evaluates a long block.
    """

    def __init__(self, timed: Sequence[Timed]) -> None:
        """Chooses by the measured times."""
        self.evaluators = [each.evaluator for each in timed]
        choice = [min(timed, key=lambda each: each.seconds(rows)) for rows in range(BLOCKS[-1] + 1)]
        self.cheapest = [each.evaluator for each in choice]

    @classmethod
    def of(cls, forest: Forest, scales: Scales, switches: Switches = ALL_ON) -> Self:
        """Lays a forest out, compiles its evaluators and times them.

        An evaluator that does not give the node walk's bits on this processor is not used.
        """
        windows = _sample(forest, BLOCKS[-1])
        expected = walk(forest, scales, windows)
        fitting = [
            (evaluator, size)
            for evaluator, size in _evaluators(forest, scales, switches)
            if _agrees(evaluator, windows[:size], expected)
        ]
        return cls(_timed(fitting or [(NodeWalkEvaluator(forest, scales), 1)], windows, expected.shape[1]))

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32]) -> None:
        """Fills `result` (n, outputs) for any number of rows: first whole blocks, then the other rows."""
        block = BLOCKS[-1]
        left = len(windows) % block
        if left and len(windows) > block and self.cheapest[left] is not self.cheapest[block]:
            self.cheapest[block].evaluate(windows[:-left], result[:-left])
            windows, result = windows[-left:], result[-left:]
        self.evaluator_of(len(windows)).evaluate(windows, result)

    def evaluator_of(self, rows: int) -> Evaluator:
        """What evaluates so many rows; if they are more than a long block, what evaluates long blocks."""
        return self.cheapest[min(rows, BLOCKS[-1])]


def _evaluators(forest: Forest, scales: Scales, switches: Switches) -> Iterator[tuple[Evaluator, int]]:
    """Every evaluator that fits the forest, and the size of its blocks."""
    index = InOrder.of(forest)
    columns = Columns.of(index)
    in_lanes = fits_lanes(columns)
    if switches.leaf_blocks and in_lanes and LeafBlocksForest.fits(forest, index):
        yield LeafBlocksEvaluator(LeafBlocksForest.of(forest, index, columns, switches), scales), ROWS
    else:
        yield NodeWalkEvaluator(forest, scales), 1
    if switches.small_batch and in_lanes and SmallBatchForest.fits(index):
        yield SmallBatchEvaluator(SmallBatchForest.of(forest, index, columns, switches), scales), ROWS
    if index.leaves.max(initial=0) <= MOST_LEAVES[2]:
        bitsets = BitsetForest.of(forest, index, columns, switches)
        for lanes, switched_on in zip(BLOCKS, (switches.bitset_64, switches.bitset_256), strict=True):
            if switched_on:
                yield BitsetEvaluator(bitsets, lanes, scales), lanes


def _sample(forest: Forest, rows: int) -> NDArray[np.float32]:
    generator = np.random.default_rng(0)
    windows = generator.standard_normal((rows, forest.features)).astype(np.float32)
    windows[generator.random(windows.shape) < 0.02] = np.nan
    return windows


def _agrees(evaluator: Evaluator, windows: NDArray[np.float32], expected: NDArray[np.float32]) -> bool:
    """Whether an evaluator gives the node walk's bits. Its first evaluation also compiles it."""
    result = np.empty((len(windows), expected.shape[1]), dtype=np.float32)
    evaluator.evaluate(windows, result)
    agrees = np.array_equal(result.view(np.int32), expected[: len(windows)].view(np.int32))
    if not agrees:
        _LOG.error(
            "%s does not agree with the node walk on this processor and is not used: please report it",
            evaluator.name,
        )
    return agrees


def _timed(
    evaluators: Sequence[tuple[Evaluator, int]], windows: NDArray[np.float32], outputs: int
) -> list[Timed]:
    """The evaluators with their times of one row and of a block."""
    calls = [
        partial(evaluator.evaluate, windows[:rows], np.empty((rows, outputs), dtype=np.float32))
        for evaluator, size in evaluators
        for rows in (1, size)
    ]
    seconds = np.array(least_seconds(calls)).reshape(-1, 2).tolist()
    return [
        Timed(evaluator, size, *times) for (evaluator, size), times in zip(evaluators, seconds, strict=True)
    ]

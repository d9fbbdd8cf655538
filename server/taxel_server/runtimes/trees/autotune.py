"""Which evaluator takes how many rows: measured when a forest is loaded."""

import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.evaluator import Evaluator
from taxel_server.runtimes.trees.few_rows.leaf_blocks import LeafBlocksEvaluator
from taxel_server.runtimes.trees.few_rows.ranks import ROWS
from taxel_server.runtimes.trees.few_rows.small_batch import SmallBatchEvaluator
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
"""Rows of a block: short ones waste fewer lanes, long ones read the forest less often."""

_LOG: Final = logging.getLogger(__name__)

_REPEATS: Final = 7


@dataclass(frozen=True)
class Timed:
    """An evaluator and what it takes: seconds for one row, and for as many as it takes at once."""

    evaluator: Evaluator
    size: int
    one: float
    whole: float

    def seconds(self, rows: int) -> float:
        """What so many rows take: between one row and a block, in proportion."""
        blocks, left = divmod(rows, self.size)
        each = (self.whole - self.one) / max(self.size - 1, 1)
        return blocks * self.whole + (self.one + each * (left - 1) if left else 0.0)


class Autotuned:
    """A forest with every evaluator that fits it, and the choice among them.

    Attributes:
        evaluators: all that fit.
        cheapest: the evaluator of every number of rows up to a long block's.
    """

    def __init__(self, timed: Sequence[Timed]) -> None:
        """Chooses by what was measured."""
        self.evaluators = [each.evaluator for each in timed]
        choice = [min(timed, key=lambda each: each.seconds(rows)) for rows in range(BLOCKS[-1] + 1)]
        self.cheapest = [each.evaluator for each in choice]

    @classmethod
    def of(cls, forest: Forest, scales: Scales, switches: Switches = ALL_ON) -> Self:
        """Lays a forest out, compiles it, and measures.

        An evaluator whose bits are not those of the node walk on this processor is not used.
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
        """Fills `result` (n, outputs) for any number of rows: whole blocks, and then what is left."""
        block = BLOCKS[-1]
        left = len(windows) % block
        if left and len(windows) > block and self.cheapest[left] is not self.cheapest[block]:
            self.cheapest[block].evaluate(windows[:-left], result[:-left])
            windows, result = windows[-left:], result[-left:]
        self.cheapest[min(len(windows), block)].evaluate(windows, result)


def _evaluators(forest: Forest, scales: Scales, switches: Switches) -> Iterator[tuple[Evaluator, int]]:
    """Every evaluator that fits the forest, and how many rows it takes at once."""
    index = InOrder.of(forest)
    columns = Columns.of(index, 8)
    in_lanes = fits_lanes(columns)
    if switches.leaf_blocks and in_lanes and LeafBlocksEvaluator.fits(forest, index):
        yield LeafBlocksEvaluator(forest, index, columns, scales, switches), ROWS
    else:
        yield NodeWalkEvaluator(forest, scales), 1
    if switches.small_batch and in_lanes and SmallBatchEvaluator.fits(index):
        yield SmallBatchEvaluator(forest, index, columns, scales, switches), ROWS
    if index.leaves.max(initial=0) <= MOST_LEAVES[2]:
        bitsets = BitsetForest.of(forest, index, switches)
        for lanes, switched_on in zip(BLOCKS, (switches.bitset_64, switches.bitset_256), strict=True):
            if switched_on:
                yield BitsetEvaluator(bitsets, lanes, scales), lanes


def _sample(forest: Forest, rows: int) -> NDArray[np.float32]:
    generator = np.random.default_rng(0)
    windows = generator.standard_normal((rows, forest.features)).astype(np.float32)
    windows[generator.random(windows.shape) < 0.02] = np.nan
    return windows


def _agrees(evaluator: Evaluator, windows: NDArray[np.float32], expected: NDArray[np.float32]) -> bool:
    """Whether an evaluator gives the node walk's bits; the first evaluation compiles it, too."""
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
    """The least times of some evaluations, in turn: a moment's disturbance must not decide for good."""
    least = np.full((len(evaluators), 2), np.inf)
    for _ in range(_REPEATS):
        for place, (evaluator, size) in enumerate(evaluators):
            for which, rows in enumerate((1, size)):
                result = np.empty((rows, outputs), dtype=np.float32)
                start = time.perf_counter()
                evaluator.evaluate(windows[:rows], result)
                least[place, which] = min(least[place, which], time.perf_counter() - start)
    return [
        Timed(evaluator, size, one, whole)
        for (evaluator, size), (one, whole) in zip(evaluators, least.tolist(), strict=True)
    ]

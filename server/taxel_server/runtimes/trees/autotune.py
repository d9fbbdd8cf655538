"""Which form evaluates how many rows: measured when a forest is loaded."""

import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.kernel import Kernel
from taxel_server.runtimes.trees.few_rows.leaf_blocks import TwigsKernel
from taxel_server.runtimes.trees.few_rows.node_walk import LinkedKernel
from taxel_server.runtimes.trees.few_rows.ranks import ROWS
from taxel_server.runtimes.trees.few_rows.small_batch import TreesKernel
from taxel_server.runtimes.trees.layout.bitsets import MOST_LEAVES
from taxel_server.runtimes.trees.layout.columns import Columns
from taxel_server.runtimes.trees.layout.in_order import InOrder
from taxel_server.runtimes.trees.layout.tree_lanes import can_stand_side_by_side
from taxel_server.runtimes.trees.many_rows.bitset import RowsForm, RowsKernel
from taxel_server.runtimes.trees.normalisation import Scales
from taxel_server.runtimes.trees.plain_walk import walk
from taxel_server.runtimes.trees.reading.forest import Forest

BLOCKS: Final = (64, 256)
"""Rows of a block: short ones waste fewer lanes, long ones read the forest less often."""

_LOG: Final = logging.getLogger(__name__)

_REPEATS: Final = 7


class WalkKernel:
    """The plain walk, where a faster form is not to be trusted."""

    name = "plain-walk"

    def __init__(self, forest: Forest, scales: Scales) -> None:
        self._forest = forest
        self._scales = scales

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32]) -> None:
        """Fills `result` (n, outputs) with what the forest says of `windows` (n, features)."""
        result[:] = walk(self._forest, self._scales, windows)


@dataclass(frozen=True)
class Timed:
    """A kernel and what it takes: seconds for one row, and for as many as it takes at once."""

    kernel: Kernel
    size: int
    one: float
    whole: float

    def seconds(self, rows: int) -> float:
        """What so many rows take: between one row and a block, in proportion."""
        blocks, rest = divmod(rows, self.size)
        each = (self.whole - self.one) / max(self.size - 1, 1)
        return blocks * self.whole + (self.one + each * (rest - 1) if rest else 0.0)


class Forms:
    """A forest in every form that fits it, and the choice among them.

    Attributes:
        kernels: the forms.
        cheapest: the kernel for every number of rows up to a long block's.
    """

    def __init__(self, timed: Sequence[Timed]) -> None:
        """Chooses by what was measured."""
        self.kernels = [each.kernel for each in timed]
        choice = [min(timed, key=lambda each: each.seconds(rows)) for rows in range(BLOCKS[-1] + 1)]
        self.cheapest = [each.kernel for each in choice]

    @classmethod
    def of(cls, forest: Forest, scales: Scales) -> Self:
        """Lays a forest out, compiles it, and measures.

        A form whose bits are not those of the plain walk on this processor is not used.
        """
        windows = _sample(forest, BLOCKS[-1])
        expected = walk(forest, scales, windows)
        kernels = [
            (kernel, size)
            for kernel, size in _kernels(forest, scales)
            if _agrees(kernel, windows[:size], expected)
        ]
        return cls(_timed(kernels or [(WalkKernel(forest, scales), 1)], windows, expected.shape[1]))

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32]) -> None:
        """Fills `result` (n, outputs) for any number of rows: whole blocks, and then the rest."""
        block = BLOCKS[-1]
        rest = len(windows) % block
        if rest and len(windows) > block and self.cheapest[rest] is not self.cheapest[block]:
            self.cheapest[block].evaluate(windows[:-rest], result[:-rest])
            windows, result = windows[-rest:], result[-rest:]
        self.cheapest[min(len(windows), block)].evaluate(windows, result)


def _kernels(forest: Forest, scales: Scales) -> Iterator[tuple[Kernel, int]]:
    """Every kernel that fits the forest, and how many rows it takes at once."""
    index = InOrder.of(forest)
    columns = Columns.of(index, 8, np.arange(forest.trees))
    side_by_side = can_stand_side_by_side(columns)
    if side_by_side and TwigsKernel.fits(forest, index):
        yield TwigsKernel(forest, index, columns, scales), ROWS
    if side_by_side and TreesKernel.fits(index):
        yield TreesKernel(forest, index, columns, scales), ROWS
    else:
        yield LinkedKernel(forest, index, scales), ROWS
    if index.leaves.max(initial=0) <= MOST_LEAVES[2]:
        form = RowsForm.of(forest, index)
        for lanes in BLOCKS:
            yield RowsKernel(form, lanes, scales), lanes


def _sample(forest: Forest, rows: int) -> NDArray[np.float32]:
    generator = np.random.default_rng(0)
    windows = generator.standard_normal((rows, forest.features)).astype(np.float32)
    windows[generator.random(windows.shape) < 0.02] = np.nan
    return windows


def _agrees(kernel: Kernel, windows: NDArray[np.float32], expected: NDArray[np.float32]) -> bool:
    """Whether a kernel gives the plain walk's bits; the first evaluation compiles it, too."""
    result = np.empty((len(windows), expected.shape[1]), dtype=np.float32)
    kernel.evaluate(windows, result)
    agrees = np.array_equal(result.view(np.int32), expected[: len(windows)].view(np.int32))
    if not agrees:
        _LOG.error(
            "%s does not agree with the plain walk on this processor and is not used: please report it",
            type(kernel).__name__,
        )
    return agrees


def _timed(
    kernels: Sequence[tuple[Kernel, int]], windows: NDArray[np.float32], outputs: int
) -> list[Timed]:
    """The least times of some evaluations, in turn: a moment's disturbance must not decide for good."""
    least = np.full((len(kernels), 2), np.inf)
    for _ in range(_REPEATS):
        for place, (kernel, size) in enumerate(kernels):
            for which, rows in enumerate((1, size)):
                result = np.empty((rows, outputs), dtype=np.float32)
                start = time.perf_counter()
                kernel.evaluate(windows[:rows], result)
                least[place, which] = min(least[place, which], time.perf_counter() - start)
    return [
        Timed(kernel, size, one, whole)
        for (kernel, size), (one, whole) in zip(kernels, least.tolist(), strict=True)
    ]

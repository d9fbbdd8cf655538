"""Which form evaluates how many rows: measured when a forest is loaded."""

import logging
import time
from dataclasses import dataclass
from typing import Final, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.trees.forest import Forest
from taxel_server.runtimes.trees.in_order import InOrder
from taxel_server.runtimes.trees.plans import Scratch
from taxel_server.runtimes.trees.rows_form import RowsForm, RowsKernel
from taxel_server.runtimes.trees.rows_layout import MOST_LEAVES
from taxel_server.runtimes.trees.scales import Scales
from taxel_server.runtimes.trees.trees_evaluation import TILE
from taxel_server.runtimes.trees.trees_form import TreesKernel
from taxel_server.runtimes.trees.walk import walk

BLOCKS: Final = (64, 256)
"""Rows of a block: short ones waste fewer lanes, long ones read the forest less often."""

_LOG: Final = logging.getLogger(__name__)

_REPEATS: Final = 5


class Kernel(Protocol):
    """A forest compiled for some number of rows; each thread needs a scratch of its own."""

    def scratch(self) -> Scratch:
        """Memory for one evaluation at a time."""

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32], scratch: Scratch) -> None:
        """Fills `result` (n, outputs) with what the forest says of `windows` (n, features)."""


@dataclass(frozen=True)
class Step:
    """One evaluation: the number of the kernel, and the rows [first, stop)."""

    kernel: int
    first: int
    stop: int


class WalkKernel:
    """The plain walk, where a faster form is not to be trusted."""

    def __init__(self, forest: Forest, scales: Scales) -> None:
        self._forest = forest
        self._scales = scales

    def scratch(self) -> Scratch:
        """Nothing: a walk needs no memory of its own."""
        return Scratch(())

    def evaluate(self, windows: NDArray[np.float32], result: NDArray[np.float32], scratch: Scratch) -> None:
        """Fills `result` (n, outputs) with what the forest says of `windows` (n, features)."""
        del scratch
        result[:] = walk(self._forest, self._scales, windows)


class Forms:
    """A forest in every form that fits it, and the choice among them.

    Attributes:
        kernels: the form for few rows, then those for blocks of BLOCKS rows, unless a tree is too
            large for them.
    """

    def __init__(self, kernels: tuple[Kernel, ...], one_row: float, seconds: tuple[float, ...]) -> None:
        """What one row costs in the first kernel; then what TILE rows do, and one block in each other."""
        self.kernels = kernels
        self._one_row = one_row
        self._seconds = seconds

    @classmethod
    def of(cls, forest: Forest, scales: Scales) -> Self:
        """Lays a forest out, compiles it, and measures.

        A form whose bits are not those of the plain walk on this processor is not used.
        """
        index = InOrder.of(forest)
        kernels: list[Kernel] = [TreesKernel(forest, index, scales)]
        sizes = [TILE]
        if index.leaves.max(initial=0) <= MOST_LEAVES[2]:
            form = RowsForm.of(forest, index)
            kernels += [RowsKernel(form, lanes, scales) for lanes in BLOCKS]
            sizes += BLOCKS
        windows = _sample(forest, max(sizes))
        expected = walk(forest, scales, windows)
        agree = [
            _agrees(kernel, windows[:size], expected) for kernel, size in zip(kernels, sizes, strict=True)
        ]
        if not agree[0]:
            kernels[0] = WalkKernel(forest, scales)
        if not all(agree[1:]):
            kernels = kernels[:1]
        timed = zip(kernels, sizes, strict=False)
        seconds = tuple(_seconds(kernel, windows[:size], expected.shape[1]) for kernel, size in timed)
        return cls(tuple(kernels), _seconds(kernels[0], windows[:1], expected.shape[1]), seconds)

    def steps(self, rows: int) -> list[Step]:
        """The cheapest way to evaluate so many rows."""
        if len(self.kernels) == 1:
            return [Step(0, 0, rows)]
        short, long = BLOCKS
        whole = rows // long * long
        steps = [Step(2, 0, whole)] if whole else []
        rest = rows - whole
        if rest:
            costs = (
                self._of_few(rest),
                -(-rest // short) * self._seconds[1],
                self._seconds[2],
            )
            steps.append(Step(costs.index(min(costs)), whole, rows))
        return steps

    def _of_few(self, rows: int) -> float:
        """What so many rows cost in the first kernel: between one row and a tile, in proportion."""
        tiles, rest = divmod(rows, TILE)
        each = (self._seconds[0] - self._one_row) / (TILE - 1)
        return tiles * self._seconds[0] + (self._one_row + each * (rest - 1) if rest else 0.0)


def _sample(forest: Forest, rows: int) -> NDArray[np.float32]:
    generator = np.random.default_rng(0)
    windows = generator.standard_normal((rows, forest.features)).astype(np.float32)
    windows[generator.random(windows.shape) < 0.02] = np.nan
    return windows


def _agrees(kernel: Kernel, windows: NDArray[np.float32], expected: NDArray[np.float32]) -> bool:
    """Whether a kernel gives the plain walk's bits; the first evaluation compiles it, too."""
    result = np.empty((len(windows), expected.shape[1]), dtype=np.float32)
    kernel.evaluate(windows, result, kernel.scratch())
    agrees = np.array_equal(result.view(np.int32), expected[: len(windows)].view(np.int32))
    if not agrees:
        _LOG.error(
            "%s does not agree with the plain walk on this processor and is not used: please report it",
            type(kernel).__name__,
        )
    return agrees


def _seconds(kernel: Kernel, windows: NDArray[np.float32], outputs: int) -> float:
    """The least time of some evaluations."""
    scratch = kernel.scratch()
    result = np.empty((len(windows), outputs), dtype=np.float32)
    times = []
    for _ in range(_REPEATS):
        start = time.perf_counter()
        kernel.evaluate(windows, result, scratch)
        times.append(time.perf_counter() - start)
    return min(times)

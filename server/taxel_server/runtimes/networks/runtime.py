"""Evaluates a network: few windows by its program, more by ONNX Runtime."""

import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.manifest import Normalisation
from taxel_server.runtimes.compiled.arguments import Scratch, pack, together
from taxel_server.runtimes.compiled.evaluator import CompiledEvaluator
from taxel_server.runtimes.compiled.processor import instruction_set
from taxel_server.runtimes.evaluators import EvaluatorInfo
from taxel_server.runtimes.networks.graph import Unsupported, read_graph
from taxel_server.runtimes.networks.lowering import lower
from taxel_server.runtimes.networks.program import Program
from taxel_server.runtimes.networks.steps import evaluate
from taxel_server.runtimes.onnx_models import OnnxRuntime

_LOG: Final = logging.getLogger(__name__)

_LIKENESS: Final = 1e-4
"""Of a channel's deviation: how far a program may lie from ONNX Runtime, both in float32."""

_MOST_ROWS: Final = 16
_REPEATS: Final = 9


class ProgramKernel(CompiledEvaluator):
    """A program, evaluated window by window."""

    name = "network-program"

    def __init__(self, program: Program) -> None:
        self._memory = program.memory
        (self._weights,) = together(program.weights)
        self._steps = program.steps
        super().__init__(evaluate, pack((self._steps, self._weights, program.window, program.channels)))

    @override
    def _scratch(self) -> Scratch:
        """Memory for one evaluation at a time."""
        return Scratch((self._memory,))


class NetworkRuntime:
    """A network whose program takes few windows, and ONNX Runtime the rest; safe to call from any thread.

    Attributes:
        features: values in one window.
        few: most windows that the program takes.
    """

    def __init__(self, kernel: ProgramKernel, many: OnnxRuntime, few: int) -> None:
        self.features = many.features
        self.few = few
        self._kernel = kernel
        self._many = many

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts (n, 21) float32 of windows (n, f) float32, C-contiguous, finite, n above 0."""
        rows = len(windows)
        if rows > self.few:
            return self._many.evaluate(windows)
        result = np.empty((rows, len(CHANNELS)), np.float32)
        self._kernel.evaluate(windows, result)
        return result

    def evaluator(self, rows: int) -> EvaluatorInfo:
        """The program, or ONNX Runtime where there are more windows than it takes."""
        if rows > self.few:
            return self._many.evaluator(rows)
        return EvaluatorInfo(self._kernel.name, instruction_set())


def compiled_network(
    model_path: Path, normalisation: Normalisation, runtime: OnnxRuntime
) -> NetworkRuntime | OnnxRuntime:
    """A runtime that evaluates few windows faster; the given one where there is none.

    Args:
        model_path: an ONNX file.
        normalisation: of its windows and channels.
        runtime: of that file, on the CPU.
    """
    try:
        kernel = ProgramKernel(lower(read_graph(model_path)))
    except Unsupported as reason:
        _LOG.info("%s: left to ONNX Runtime as a whole: %s", model_path, reason)
        return runtime
    except Exception:  # A graph that nobody thought of is no reason not to serve it.
        _LOG.exception("%s: could not be compiled; ONNX Runtime serves it: please report it", model_path)
        return runtime
    windows = _sample(normalisation)
    if not _agrees(kernel, windows, runtime, normalisation):
        _LOG.error(
            "%s: its program does not agree with ONNX Runtime here and is not used: please report it",
            model_path,
        )
        return runtime
    few = _fewer(kernel, windows, runtime)
    return NetworkRuntime(kernel, runtime, few) if few else runtime


def _sample(normalisation: Normalisation) -> NDArray[np.float32]:
    draws = np.random.default_rng(0).standard_normal((_MOST_ROWS, len(normalisation.input_mean)))
    return (draws * normalisation.input_std + normalisation.input_mean).astype(np.float32)


def _agrees(
    kernel: ProgramKernel, windows: NDArray[np.float32], runtime: OnnxRuntime, normalisation: Normalisation
) -> bool:
    """Whether a program gives what ONNX Runtime gives; the first evaluation compiles it, too."""
    expected = runtime.evaluate(windows)
    result = np.empty_like(expected)
    kernel.evaluate(windows, result)
    return bool((np.abs(result - expected) <= _LIKENESS * np.array(normalisation.output_std)).all())


def _fewer(kernel: ProgramKernel, windows: NDArray[np.float32], runtime: OnnxRuntime) -> int:
    """Most windows that the program evaluates at least as fast as ONNX Runtime."""
    result = np.empty((1, len(CHANNELS)), np.float32)
    one = _least_seconds(lambda: kernel.evaluate(windows[:1], result))
    for rows in range(1, len(windows) + 1):
        some = windows[:rows]
        if rows * one > _least_seconds(lambda some=some: runtime.evaluate(some)):  # type: ignore[misc]
            return rows - 1
    return len(windows)


def _least_seconds(evaluation: Callable[[], object]) -> float:
    """The least of some: a moment's disturbance must not decide for good."""
    least = np.inf
    for _ in range(_REPEATS):
        start = time.perf_counter()
        evaluation()
        least = min(least, time.perf_counter() - start)
    return least

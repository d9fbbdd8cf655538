"""Evaluates a network: few windows by its program, more by ONNX Runtime."""

import logging
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.artifacts import Artifact
from taxel.channels import CHANNELS
from taxel.manifest import Normalisation
from taxel_server.runtimes.compiled.arguments import together
from taxel_server.runtimes.compiled.compiling import announce
from taxel_server.runtimes.compiled.evaluator import CompiledEvaluator
from taxel_server.runtimes.compiled.processor import instruction_set
from taxel_server.runtimes.evaluator_info import EvaluatorInfo
from taxel_server.runtimes.graph_checks import check_graph
from taxel_server.runtimes.networks.evaluation import evaluate
from taxel_server.runtimes.networks.graph import Unsupported, read_graph
from taxel_server.runtimes.networks.lowering import lower
from taxel_server.runtimes.networks.program import Program
from taxel_server.runtimes.onnx_models import OnnxRuntime
from taxel_server.runtimes.options import DEFAULTS, RuntimeOptions
from taxel_server.runtimes.timing import least_seconds

_LOG: Final = logging.getLogger(__name__)

_TOLERANCE: Final = 1e-4
"""How far a program may lie from ONNX Runtime, in standard deviations of a channel."""

_MOST_WINDOWS: Final = 16


class ProgramEvaluator(CompiledEvaluator):
    """A program, evaluated window by window; safe to call from any thread."""

    name = "network-program"

    def __init__(self, program: Program) -> None:
        (weights,) = together(program.weights)
        program = program._replace(weights=weights)
        arguments = (program.steps, weights, program.window, program.channels)
        super().__init__((program,), evaluate, [arguments], (program.memory,))

    def counts(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts (n, 21) float32 of windows (n, f) float32."""
        result = np.empty((len(windows), len(CHANNELS)), np.float32)
        self.evaluate(windows, result)
        return result


class NetworkRuntime:
    """A network whose program takes few windows, and ONNX Runtime more; safe to call from any thread.

    Attributes:
        features: values in one window.
        most_windows: that the program takes.
    """

    def __init__(self, program: ProgramEvaluator, onnx_runtime: OnnxRuntime, most_windows: int) -> None:
        self.features = onnx_runtime.features
        self.most_windows = most_windows
        self._program = program
        self._onnx_runtime = onnx_runtime

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts (n, 21) float32 of windows (n, f) float32, C-contiguous, finite, n above 0."""
        if len(windows) > self.most_windows:
            return self._onnx_runtime.evaluate(windows)
        return self._program.counts(windows)

    def evaluator(self, rows: int) -> EvaluatorInfo:
        """The program, or ONNX Runtime where there are more windows than it takes."""
        if rows > self.most_windows:
            return self._onnx_runtime.evaluator(rows)
        return EvaluatorInfo(self._program.name, instruction_set())


def open_artifact(artifact: Artifact, options: RuntimeOptions) -> NetworkRuntime | OnnxRuntime:
    """The runtime of an artifact's ONNX file."""
    path, normalisation = artifact.model_path, artifact.manifest.normalisation
    check_graph(path)
    runtime = OnnxRuntime(path, normalisation, options.threads, options.providers)
    if runtime.features != len(normalisation.input_mean):
        return runtime  # which `open_runtime` refuses
    if options.providers != DEFAULTS.providers or not options.network_program:
        return runtime
    return faster_runtime(path, normalisation, runtime)


def faster_runtime(
    model_path: Path, normalisation: Normalisation, onnx_runtime: OnnxRuntime
) -> NetworkRuntime | OnnxRuntime:
    """A runtime that evaluates few windows faster; the given one where there is none.

    Args:
        model_path: an ONNX file.
        normalisation: of its windows and channels.
        onnx_runtime: of that file, on the CPU.
    """
    try:
        program = ProgramEvaluator(lower(read_graph(model_path)))
        announce()
        draws = np.random.default_rng(0).standard_normal((_MOST_WINDOWS, onnx_runtime.features))
        windows = (draws * normalisation.input_std + normalisation.input_mean).astype(np.float32)
        counts = program.counts(windows)
    except Unsupported as reason:
        _LOG.info("%s: left to ONNX Runtime as a whole: %s", model_path, reason)
        return onnx_runtime
    except Exception:  # A graph that nobody thought of is no reason not to serve it.
        _LOG.exception("%s: could not be compiled; ONNX Runtime serves it: please report it", model_path)
        return onnx_runtime
    difference = np.abs(counts - onnx_runtime.evaluate(windows))
    if not (difference <= _TOLERANCE * np.array(normalisation.output_std)).all():
        _LOG.error(
            "%s: its program does not agree with ONNX Runtime here and is not used: please report it",
            model_path,
        )
        return onnx_runtime
    most_windows = _most_windows(program, windows, onnx_runtime)
    return NetworkRuntime(program, onnx_runtime, most_windows) if most_windows else onnx_runtime


def _most_windows(
    program: ProgramEvaluator, windows: NDArray[np.float32], onnx_runtime: OnnxRuntime
) -> int:
    """The most windows that the program evaluates at least as fast as ONNX Runtime."""
    for count in range(1, len(windows) + 1):
        some = windows[:count]
        ours, theirs = least_seconds([partial(program.counts, some), partial(onnx_runtime.evaluate, some)])
        if ours > theirs:
            return count - 1
    return len(windows)

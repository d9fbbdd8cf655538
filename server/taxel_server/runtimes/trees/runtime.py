"""Evaluates the forest of one artifact."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxel.artifacts import Artifact
from taxel.errors import ArtifactError
from taxel.manifest import Normalisation
from taxel_server import memory
from taxel_server.runtimes.compiled.compiling import announce
from taxel_server.runtimes.compiled.processor import instruction_set
from taxel_server.runtimes.evaluator_info import EvaluatorInfo
from taxel_server.runtimes.options import RuntimeOptions
from taxel_server.runtimes.trees.autotune import BLOCKS, Autotuned
from taxel_server.runtimes.trees.normalisation import Scales
from taxel_server.runtimes.trees.reading.xgboost_json import read_forest


class TreesRuntime:
    """An XGBoost forest with one output a channel, loaded and compiled; safe to call from any thread.

    A pickle of it is read without parsing, laying out or timing anything.

    Attributes:
        features: number of inputs.
    """

    def __init__(self, model_path: Path, normalisation: Normalisation, threads: int = 1) -> None:
        """Loads a forest, lays it out, compiles, checks and times its evaluators.

        Args:
            model_path: XGBoost's JSON model file.
            normalisation: how windows become the model's inputs, and its outputs counts.
            threads: the most threads that one call may use.

        Raises:
            ArtifactError: the file is damaged, not supported, or at odds with the normalisation.
        """
        forest = read_forest(model_path)
        announce()
        self.features = forest.features
        self._outputs = len(forest.base_score)
        for name, found, expected in (
            ("inputs", self.features, len(normalisation.input_mean)),
            ("outputs", self._outputs, len(normalisation.output_mean)),
        ):
            if found != expected:
                raise ArtifactError(f"{model_path}: the model has {found} {name}: expected {expected}")
        self._autotuned = Autotuned.of(forest, Scales.of(normalisation))
        self._cheapest = self._autotuned.cheapest
        del forest
        memory.give_back()  # what reading and layout took
        self._threads = threads
        self._pool = _pool_of(threads)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_pool"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._pool = _pool_of(self._threads)

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Evaluates windows (n, features) to (n, outputs) float32; NaN and infinities are allowed.

        The windows are C-contiguous float32.
        """
        rows = len(windows)
        result = np.empty((rows, self._outputs), np.float32)
        if rows < len(self._cheapest):
            # This path is short on purpose: its Python objects have left the caches since the last call.
            self._cheapest[rows].evaluate(windows, result)
        elif self._pool is None:
            self._autotuned.evaluate(windows, result)
        else:
            self._share(self._pool, windows, result)
        return result

    def evaluator(self, rows: int) -> EvaluatorInfo:
        """The evaluator of so many windows; if they are more than one long block, that of whole blocks."""
        return EvaluatorInfo(self._autotuned.evaluator_of(rows).name, instruction_set())

    def _share(
        self, pool: ThreadPoolExecutor, windows: NDArray[np.float32], result: NDArray[np.float32]
    ) -> None:
        """Gives whole blocks to each thread. The calling thread is one of them."""
        rows = len(windows)
        shares = min(self._threads, rows // BLOCKS[-1])
        bounds = [rows * share // shares // BLOCKS[-1] * BLOCKS[-1] for share in range(1, shares)]
        (own, *windows_of_others), (filled, *results) = np.split(windows, bounds), np.split(result, bounds)
        others = pool.map(self._autotuned.evaluate, windows_of_others, results)
        self._autotuned.evaluate(own, filled)
        list(others)  # waits for them


def open_artifact(artifact: Artifact, options: RuntimeOptions) -> TreesRuntime:
    """The runtime of an artifact's forest."""
    return TreesRuntime(artifact.model_path, artifact.manifest.normalisation, options.threads)


def _pool_of(threads: int) -> ThreadPoolExecutor | None:
    return ThreadPoolExecutor(threads - 1, "trees") if threads > 1 else None

"""Evaluates the forest of one artifact."""

import ctypes
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import ArtifactError
from taxel.manifest import Normalisation
from taxel_server.runtimes.trees.forms import BLOCKS, Forms
from taxel_server.runtimes.trees.parse import read_forest
from taxel_server.runtimes.trees.plans import Scratch
from taxel_server.runtimes.trees.scales import Scales

_SHARE: Final = BLOCKS[-1]
"""Fewest rows worth handing to another thread."""


class TreesRuntime:
    """An XGBoost forest with one output a channel, loaded and compiled; safe to call from any thread.

    Attributes:
        features: number of inputs.
        parameters: number of nodes.
    """

    features: int
    parameters: int

    def __init__(self, model_path: Path, normalisation: Normalisation, threads: int = 1) -> None:
        """Loads, lays out, compiles, checks and measures.

        Args:
            model_path: XGBoost's JSON model file.
            normalisation: how windows become the model's inputs, and its outputs counts.
            threads: most threads that one call may use.

        Raises:
            ArtifactError: the file is damaged, not supported, or at odds with the normalisation.
        """
        forest = read_forest(model_path)
        self.features = forest.features
        self.parameters = forest.nodes
        self._outputs = len(forest.base_score)
        for name, found, expected in (
            ("inputs", self.features, len(normalisation.input_mean)),
            ("outputs", self._outputs, len(normalisation.output_mean)),
        ):
            if found != expected:
                raise ArtifactError(f"{model_path}: the model has {found} {name}: expected {expected}")
        self._forms = Forms.of(forest, Scales.of(normalisation))
        del forest
        _give_memory_back()
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads - 1, "trees") if threads > 1 else None
        self._scratches = _Scratches()

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, features) C-contiguous float32 to (n, outputs) float32; NaN and infinities are values too."""
        result = np.empty((len(windows), self._outputs), dtype=np.float32)
        shares = min(self._threads, len(windows) // _SHARE)
        if self._pool is None or shares < 2:
            self._fill(windows, result)
            return result
        bounds = [len(windows) * share // shares // _SHARE * _SHARE for share in range(shares)] + [
            len(windows)
        ]
        others = [
            self._pool.submit(self._fill, windows[first:stop], result[first:stop])
            for first, stop in pairwise(bounds[1:])
        ]
        self._fill(windows[: bounds[1]], result[: bounds[1]])
        for other in others:
            other.result()
        return result

    def _fill(self, windows: NDArray[np.float32], result: NDArray[np.float32]) -> None:
        steps = self._forms.steps(len(windows))
        for kernel, first, stop in steps:
            # Slices cost a single row more than they should.
            rows, place = (windows[first:stop], result[first:stop]) if len(steps) > 1 else (windows, result)
            self._forms.kernels[kernel].evaluate(rows, place, self._scratch(kernel))

    def _scratch(self, kernel: int) -> Scratch:
        """This thread's scratch for a kernel, made on first use."""
        scratch = self._scratches.of.get(kernel)
        if scratch is None:
            scratch = self._scratches.of[kernel] = self._forms.kernels[kernel].scratch()
        return scratch


class _Scratches(threading.local):
    """The memory that each thread evaluates with, by kernel."""

    def __init__(self) -> None:
        self.of: dict[int, Scratch] = {}


def _give_memory_back() -> None:
    """What parsing and laying out took, which glibc would keep until asked."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)

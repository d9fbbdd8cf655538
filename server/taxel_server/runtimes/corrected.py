"""Evaluates a corrected model: any platform's model file, and the effects of its manifest."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxel.corrections import Correction
from taxel.corrections.correction import Evaluate
from taxel.manifest import Manifest
from taxel_server.runtimes.evaluator_info import EvaluatorInfo


class CorrectedRuntime:
    """A runtime whose predictions the manifest's effects correct. As thread-safe as what it wraps.

    Args:
        evaluate: the model file's runtime, which takes only its own columns.
        evaluator: that runtime's, by the number of windows.
        manifest: with effects.

    Attributes:
        features: values in one window.
    """

    def __init__(
        self, evaluate: Evaluate, evaluator: Callable[[int], EvaluatorInfo], manifest: Manifest
    ) -> None:
        self._given = (evaluate, evaluator, manifest)
        self._evaluate = evaluate
        self._evaluator = evaluator
        self._correction = Correction(manifest.effects, manifest.spec, manifest.window.extras)
        self.features = len(manifest.window.features)

    def __reduce__(self) -> tuple[Any, ...]:
        return CorrectedRuntime, self._given

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts of windows (n, f) float32, C-contiguous, finite, n above 0.

        Returns:
            (n, 21) float32, or (n, 42) with the spread of each channel behind the channels.
        """
        return self._correction.apply(self._evaluate, windows)

    def evaluator(self, rows: int) -> EvaluatorInfo:
        """Which evaluator computes so many windows before they are corrected."""
        return self._evaluator(rows)

    def evaluate_base(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """What the model file gives to the same windows, turned by the frames and without any term."""
        return self._correction.base(self._evaluate, windows)

"""Evaluates the forest of one artifact."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taxel.errors import ArtifactError
from taxel.manifest import Normalisation
from taxel.scaling import Scaler
from taxel_server.runtimes.trees.parse import read_forest
from taxel_server.runtimes.trees.walk import walk


class TreesRuntime:
    """An XGBoost forest with one output a channel, loaded and compiled; safe to call from any thread.

    Attributes:
        features: number of inputs.
        parameters: number of nodes.
    """

    features: int
    parameters: int

    def __init__(self, model_path: Path, normalisation: Normalisation, threads: int = 1) -> None:
        """Loads and warms up.

        Args:
            model_path: XGBoost's JSON model file.
            normalisation: how windows become the model's inputs, and its outputs counts.
            threads: most threads that one call may use.

        Raises:
            ArtifactError: the file is damaged, not supported, or at odds with the normalisation.
        """
        self._forest = read_forest(model_path)
        self._inputs = Scaler.of(normalisation.input_mean, normalisation.input_std)
        self._outputs = Scaler.of(normalisation.output_mean, normalisation.output_std)
        self._folded = normalisation.folded
        self._threads = threads
        self.features = self._forest.features
        self.parameters = self._forest.nodes
        for name, found, expected in (
            ("inputs", self.features, len(normalisation.input_mean)),
            ("outputs", len(self._forest.base_score), len(normalisation.output_mean)),
        ):
            if found != expected:
                raise ArtifactError(f"{model_path}: the model has {found} {name}: expected {expected}")
        self.evaluate(np.zeros((1, self.features), dtype=np.float32))

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, features) C-contiguous float32 to (n, outputs) float32; NaN and infinities are values too."""
        if self._folded:
            return walk(self._forest, windows)
        return self._outputs.restore(walk(self._forest, self._inputs.normalise(windows)))

"""What the loop and its benchmark need of a model, and its predictions for many windows."""

from collections.abc import Callable
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.manifest import Manifest

ROWS_A_REQUEST: Final = 4096
"""Any server takes so many windows at once."""

Predict = Callable[[NDArray[np.float32]], NDArray[np.float32]]


class Model(Protocol):
    """A model, such as a predictor of `taxel.load`."""

    @property
    def manifest(self) -> Manifest:
        """Everything known of the model."""

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 21) counts of windows (n, f)."""

    def predict_base(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 21) counts of the same windows without the effects of the manifest."""


def predict_all(predict: Predict, windows: NDArray[np.float32]) -> NDArray[np.float64]:
    """(n, 21) counts, in requests of a size that any server takes."""
    parts = [
        predict(windows[start : start + ROWS_A_REQUEST]) for start in range(0, len(windows), ROWS_A_REQUEST)
    ]
    return np.concatenate(parts).astype(np.float64)[:, : len(CHANNELS)]

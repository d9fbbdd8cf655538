"""Whether an artifact predicts what its trained model does, on held-out windows."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import taxel
from taxel.channels import CHANNELS
from taxel.errors import ArtifactError
from taxel.manifest import Parity
from taxel_models.training.trained import TrainedModel

MOST_WINDOWS: Final = 8192


def check_parity(
    repository: Path, name: str, trained: TrainedModel, windows: NDArray[np.float32], tolerance: float
) -> Parity:
    """Compare the artifact, as it will be served, with the library that trained the model.

    Args:
        windows: (n, f) held-out windows; evenly spaced ones are taken where there are very many.
        tolerance: largest difference allowed, counts.

    Raises:
        ArtifactError: a prediction differs by more than `tolerance`, or is not finite.
    """
    chosen = windows[np.linspace(0, len(windows) - 1, min(len(windows), MOST_WINDOWS)).astype(np.int64)]
    expected = trained.predict(chosen)
    with taxel.load(repository) as source:
        found = source.predictor(name).predict(chosen)
    differences = np.abs(found.astype(np.float64) - expected)
    largest = float(differences.max())
    if not largest <= tolerance:
        row, column = np.unravel_index(int(np.argmax(np.nan_to_num(differences, nan=np.inf))), found.shape)
        raise ArtifactError(
            f"parity: window {row}, channel {CHANNELS[column]}: the artifact gives {found[row, column]}, "
            f"the trained model {expected[row, column]}: expected at most {tolerance:g} counts between them"
        )
    return Parity(windows=len(chosen), largest_difference=largest, tolerance=tolerance)

"""Compares an artifact's predictions with the expected ones."""

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import ArtifactError
from taxel.manifest import Parity


def agreement(
    found: NDArray[np.float32],
    expected: NDArray[np.float32] | NDArray[np.float64],
    tolerance: float,
    source: str,
) -> Parity:
    """The differences between an artifact's predictions and the expected ones.

    Args:
        found: (n, 21), the artifact's predictions, counts; n above 0.
        expected: (n, 21), the expected predictions, counts.
        tolerance: largest difference allowed, counts.
        source: what gives the expected predictions, for the error's text.

    Raises:
        ArtifactError: a prediction differs by more than `tolerance`, or is not finite.
    """
    differences = np.nan_to_num(np.abs(found.astype(np.float64) - expected), nan=np.inf)
    row, column = np.unravel_index(int(np.argmax(differences)), differences.shape)
    largest = float(differences[row, column])
    if largest > tolerance:
        raise ArtifactError(
            f"parity: window {row}, channel {CHANNELS[column]}: the artifact gives {found[row, column]}, "
            f"{source} {expected[row, column]}: expected at most {tolerance:g} counts between them"
        )
    return Parity(windows=len(found), largest_difference=largest, tolerance=tolerance)

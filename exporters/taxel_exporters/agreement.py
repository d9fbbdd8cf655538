"""Whether an artifact's predictions agree with those that it should give."""

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
    """How far an artifact's predictions are from those expected.

    Args:
        found: (n, 21) what the artifact gives, counts; n above 0.
        expected: (n, 21) what it should give, counts.
        tolerance: largest difference allowed, counts.
        source: who gives what is expected, for the error's text.

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

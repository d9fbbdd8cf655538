"""The standard error of a mean over the folds of a cross-validation.

The folds share training data, so a plain paired t-test finds differences too often. Nadeau and Bengio
(Inference for the generalization error, Machine Learning 52, 2003) enlarge its variance by the ratio of
test to training data.
"""

import math

import numpy as np
from numpy.typing import NDArray


def corrected_standard_error(by_fold: NDArray[np.float64], test_ratio: float) -> float:
    """Standard error of the mean over folds: sqrt((1/J + n2/n1) var), with J - 1 degrees of freedom.

    Args:
        by_fold: (J,) a figure of each fold, or the difference of two; J > 1.
        test_ratio: n2/n1, test over training data of a fold.
    """
    return float(by_fold.std(ddof=1)) * math.sqrt(1 / len(by_fold) + test_ratio)

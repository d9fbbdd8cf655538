"""The first-order low-pass: the filter of all slow parts of the twin."""

from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

PERIOD_S: Final = 0.01
"""Between two rows: the BioTac 2P sends 100 frames a second."""


def lagged(signal: NDArray[np.float64], time_constant_s: float) -> NDArray[np.float64]:
    """A signal (n,) after a first-order low-pass that starts settled at the first value."""
    share = 1.0 - np.exp(-PERIOD_S / time_constant_s)
    steps = accumulate(signal.tolist(), lambda state, value: state + share * (value - state))
    return np.fromiter(steps, dtype=np.float64, count=len(signal))

"""The first-order low-pass: the filter of all slow parts of the twin."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

PERIOD_S: Final = 0.01
"""Between two rows: the BioTac 2P sends 100 frames a second."""


def lagged(signal: NDArray[np.float64], time_constant_s: float) -> NDArray[np.float64]:
    """A signal (n,) after a first-order low-pass that starts settled at the first value."""
    share = 1.0 - np.exp(-PERIOD_S / time_constant_s)
    state = float(signal[0]) if len(signal) else 0.0
    return np.array([state := state + share * (value - state) for value in signal.tolist()])

"""Streams that were recorded with clocks of their own, brought to the times of one of them."""

import numpy as np
from numpy.typing import NDArray


def interpolated(
    time: NDArray[np.int64], known: NDArray[np.int64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Values (n, k) at the times `known` (n,), ns, interpolated linearly at `time` (m,), ns: (m, k)."""
    # ns since the first stamp fit a float64 exactly; ns since the epoch would not.
    at, since = time - known[0], known - known[0]
    return np.column_stack([np.interp(at, since, column) for column in values.T])


def bracket_s(time: NDArray[np.int64], known: NDArray[np.int64]) -> NDArray[np.float64]:
    """Seconds between the stamps before and after each time; 0 where a time is a stamp."""
    after = np.searchsorted(known, time)
    before = np.searchsorted(known, time, side="right") - 1
    return np.asarray((known[after] - known[before]) / 1e9)

"""When the queries of the server scenario arrive: a Poisson process."""

import numpy as np
from numpy.typing import NDArray


def poisson_arrivals(rate_qps: float, queries: int, seed: int) -> NDArray[np.float64]:
    """Arrival times of a Poisson process, (queries,), seconds from the start, ascending.

    The gaps are independent and exponential with mean 1 / rate. The first n times are the same
    for every `queries` >= n.
    """
    return np.random.default_rng(seed).exponential(1 / rate_qps, queries).cumsum()

"""Times ways of evaluating a model when it is loaded, to choose the fastest one."""

import time
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

_REPEATS: Final = 9


def least_seconds(calls: Sequence[Callable[[], object]]) -> list[float]:
    """The least time of each call. The calls take turns, so that a short disturbance decides nothing."""
    least = [np.inf] * len(calls)
    for _ in range(_REPEATS):
        for place, call in enumerate(calls):
            start = time.perf_counter()
            call()
            least[place] = min(least[place], time.perf_counter() - start)
    return least

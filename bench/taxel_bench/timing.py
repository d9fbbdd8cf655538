"""Latencies: taken call by call after a warm-up, told as a median and tails."""

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Latencies:
    """Seconds of many calls.

    Attributes:
        seconds: (calls,) in the order in which they were made.
    """

    seconds: NDArray[np.float64]

    @classmethod
    def of(cls, call: Callable[[int], object], *, warm_up: int, repetitions: int) -> Self:
        """Time `call(0)`, `call(1)` …; garbage is collected before, not during.

        Args:
            call: told the number of the repetition, to vary its input.
        """
        for number in range(warm_up):
            call(number)
        seconds = np.empty(repetitions)
        gc.collect()
        gc.disable()
        try:
            for number in range(repetitions):
                start = time.perf_counter()
                call(number)
                seconds[number] = time.perf_counter() - start
        finally:
            gc.enable()
        return cls(seconds)

    def percentile_ms(self, share: float) -> float:
        """The latency that `share` percent of calls stay within, ms."""
        return float(np.percentile(self.seconds, share)) * 1e3

    @property
    def median_ms(self) -> float:
        """The middle latency, ms."""
        return self.percentile_ms(50)

    def report(self) -> dict[str, float | int]:
        """The figures that every report has."""
        return {
            "repetitions": len(self.seconds),
            "median_ms": self.median_ms,
            "p90_ms": self.percentile_ms(90),
            "p99_ms": self.percentile_ms(99),
        }

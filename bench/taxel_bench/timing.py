"""Latencies: measured call by call after a warm-up, reported as a median and tails."""

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Call = Callable[[int], object]
"""Told the number of the repetition, to vary its input."""

_FEWEST_WARM_UP_ROUNDS: Final = 3


@dataclass(frozen=True)
class Latencies:
    """Seconds of many calls.

    Attributes:
        seconds: (calls,) in the order in which they were made.
    """

    seconds: NDArray[np.float64]

    def percentile_ms(self, share: float) -> float:
        """The latency that `share` percent of calls stay within, ms."""
        return float(np.percentile(self.seconds, share)) * 1e3

    @property
    def median_ms(self) -> float:
        """The middle latency, ms."""
        return self.percentile_ms(50)

    @property
    def drift(self) -> float:
        """The relative difference between the medians of the later and the earlier half of the calls."""
        earlier, later = np.array_split(self.seconds, 2)
        return float(abs(np.median(later) / np.median(earlier) - 1))

    def report(self) -> dict[str, float | int]:
        """The figures that every report has."""
        return {
            "repetitions": len(self.seconds),
            "median_ms": self.median_ms,
            "p90_ms": self.percentile_ms(90),
            "p99_ms": self.percentile_ms(99),
        }


@dataclass(frozen=True)
class TimedCalls(Latencies):
    """Latencies of calls, with the processor time of this process meanwhile.

    Attributes:
        cpu_seconds: (calls,) that all threads of this process ran.
    """

    cpu_seconds: NDArray[np.float64]

    @property
    def cpu_median_ms(self) -> float:
        """The middle processor time of a call, ms."""
        return float(np.median(self.cpu_seconds)) * 1e3

    @property
    def running(self) -> float:
        """Processors that the calls used in the mean: less than 1 where other programs took some."""
        return float(self.cpu_seconds.sum() / self.seconds.sum())


def interleaved(
    calls: Sequence[Call],
    *,
    repetitions: int,
    seed: int = 0,
    together: int = 1,
    watch: Callable[[int], None] = lambda _: None,
) -> list[TimedCalls]:
    """Time each call once a round, in a new order each round: each finds in the caches what others left.

    Args:
        repetitions: rounds.
        seed: of the orders.
        together: so many calls, one after the other, keep their order and stay together.
        watch: told after each round how many are done.
    """
    orders = list(_orders(len(calls) // together, repetitions, seed))
    wall, cpu = _time_rounds(calls, orders, together, watch)
    return [TimedCalls(*seconds) for seconds in zip(wall, cpu, strict=True)]


def warm_up(calls: Sequence[Call], *, rounds: int, seconds: float) -> float:
    """Make each call once a round, at least three times, until the rounds or the seconds are over.

    Returns:
        Seconds that one round takes, by the median.
    """
    taken: list[float] = []
    while len(taken) < _FEWEST_WARM_UP_ROUNDS or (len(taken) < rounds and sum(taken) < seconds):
        start = time.perf_counter()
        for call in calls:
            call(len(taken))
        taken.append(time.perf_counter() - start)
    return float(np.median(taken))


def _orders(groups: int, rounds: int, seed: int) -> Iterator[list[int]]:
    """A permutation for each round, at random; none starts with what the one before it ended with."""
    generator = np.random.default_rng(seed)
    last = -1
    for _ in range(rounds):
        order = generator.permutation(groups)
        while groups > 1 and order[0] == last:
            order = generator.permutation(groups)
        last = order[-1]
        yield order.tolist()


def _time_rounds(
    calls: Sequence[Call], orders: Sequence[Sequence[int]], together: int, watch: Callable[[int], None]
) -> NDArray[np.float64]:
    """Seconds and processor seconds of each call in each round, (2, calls, rounds).

    Garbage is collected before, not during.
    """
    seconds = np.empty((2, len(calls), len(orders)))
    gc.collect()
    gc.disable()
    try:
        for number, order in enumerate(orders):
            for group in order:
                for place in range(group * together, (group + 1) * together):
                    running = time.process_time()
                    start = time.perf_counter()
                    calls[place](number)
                    end = time.perf_counter()
                    seconds[:, place, number] = end - start, time.process_time() - running
            watch(number + 1)
    finally:
        gc.enable()
    return seconds

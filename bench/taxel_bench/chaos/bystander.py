"""A client that behaves, while others do not: it must always get the same answer."""

import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import RequestError
from taxel.predictor import Predictor
from taxel.remote import RemoteSource
from taxel.remote.options import Transport
from taxel_bench.chaos.bars import Bar
from taxel_bench.windows import random_windows

_PAUSE_S: Final = 0.01


class Bystander:
    """Asks for the same window again and again.

    Attributes:
        answers: that were right.
        wrong: that were not.
        errors: by code.
        longest_ms: the longest time that an answer took.
    """

    def __init__(self, predictor: Predictor) -> None:
        self.answers = self.wrong = 0
        self.errors: Counter[str] = Counter()
        self.longest_ms = 0.0
        self._predictor = predictor
        self._window: NDArray[np.float32] = random_windows(predictor.manifest, 1, 7)
        self._expected = predictor.predict(self._window)

    @property
    def failed(self) -> int:
        """Requests without the right answer."""
        return self.wrong + self.errors.total()

    def as_dict(self) -> dict[str, Any]:
        """For `--json`."""
        return {
            "answers": self.answers,
            "failed": self.failed,
            "errors": dict(self.errors),
            "longest_ms": self.longest_ms,
        }

    def ask(self) -> None:
        """Ask once."""
        asked = time.perf_counter()
        try:
            same = np.array_equal(self._predictor.predict(self._window), self._expected)
        except RequestError as error:
            self.errors[error.code] += 1
            return
        self.longest_ms = max(self.longest_ms, (time.perf_counter() - asked) * 1e3)
        self.answers += same
        self.wrong += not same

    def until(self, over: Event) -> None:
        """Ask until something is over, and once more."""
        while not over.wait(_PAUSE_S):
            self.ask()
        self.ask()


@contextmanager
def bystanders(endpoint: str, model: str) -> Iterator[list[Bystander]]:
    """One client over the lane and one over zenoh, which ask for as long as the block lasts."""
    over = Event()
    ways: tuple[Transport, ...] = ("lane", "zenoh")
    sources = [RemoteSource(endpoint, timeout=10, transport=transport) for transport in ways]
    try:
        several = [Bystander(source.predictor(model)) for source in sources]
        threads = [Thread(target=each.until, args=(over,)) for each in several]
        for thread in threads:
            thread.start()
        try:
            yield several
        finally:
            over.set()
            for thread in threads:
                thread.join()
    finally:
        for source in sources:
            source.close()


def bar_of_failed(beside: str, told: Sequence[Mapping[str, Any]]) -> Bar:
    """That no request of these bystanders failed, as `Bystander.as_dict` tells them."""
    failed = float(sum(each["failed"] for each in told))
    return Bar(f"clients that behave, beside {beside}: requests that failed", failed, 0.0)

"""How evaluators are timed at load."""

from collections.abc import Callable

import pytest

from taxel_server.runtimes import timing


def test_a_disturbance_slows_what_is_compared_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process takes the processor for the first half of all calls."""
    clock, calls = [0.0], [0]

    def taking(seconds: float) -> Callable[[], None]:
        def call() -> None:
            calls[0] += 1
            clock[0] += seconds * (10 if calls[0] <= timing._REPEATS else 1)

        return call

    monkeypatch.setattr(timing.time, "perf_counter", lambda: clock[0])
    ours, theirs = timing.least_seconds([taking(1.0), taking(2.0)])
    assert (ours, theirs) == (pytest.approx(1.0), pytest.approx(2.0))

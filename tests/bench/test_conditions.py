"""What makes a measurement invalid."""

import time

import numpy as np
import pytest

from taxel_bench.conditions import disturbances, stolen_time
from taxel_bench.timing import TimedCalls, interleaved, warm_up

STEADY = np.full(100, 0.001)


def test_an_undisturbed_steady_measurement_has_no_reason_against_it() -> None:
    assert disturbances(TimedCalls(STEADY, STEADY), stolen=0.0) == []


@pytest.mark.parametrize(
    ("seconds", "cpu_seconds", "stolen", "reason"),
    [
        (STEADY, STEADY * 0.9, 0.0, "other programs took 10%"),
        (STEADY, STEADY, 0.05, "hypervisor gave 5%"),
        (np.repeat([0.001, 0.0012], 50), np.repeat([0.001, 0.0012], 50), 0.0, "halves differ by 20%"),
    ],
)
def test_each_disturbance_is_named(
    seconds: np.ndarray, cpu_seconds: np.ndarray, stolen: float, reason: str
) -> None:
    (found,) = disturbances(TimedCalls(seconds, cpu_seconds), stolen)
    assert reason in found


def test_calls_take_turns_and_waiting_is_no_processor_time() -> None:
    order: list[str] = []
    with stolen_time() as stolen:
        idle, busy = interleaved(
            [lambda _: order.append("idle") or time.sleep(0.002), lambda _: order.append("busy")],
            repetitions=5,
        )
    assert order == ["idle", "busy"] * 5
    assert idle.running < 0.9
    assert (idle.seconds >= 0.002).all()
    assert len(busy.seconds) == 5
    assert 0 <= stolen() <= 1


def test_warming_up_ends_by_rounds_or_by_time() -> None:
    calls: list[int] = []
    warm_up([calls.append], rounds=7, seconds=60)
    assert calls == list(range(7))
    assert warm_up([lambda _: time.sleep(0.002)], rounds=1000, seconds=0.0) >= 0.002

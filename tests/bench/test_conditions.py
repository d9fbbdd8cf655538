"""What makes a measurement invalid."""

import time
from itertools import pairwise

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
    assert order in (["idle", "busy"] * 5, ["busy", "idle"] * 5)
    assert idle.running < 0.9
    assert (idle.seconds >= 0.002).all()
    assert len(busy.seconds) == 5
    assert 0 <= stolen() <= 1


def order_of(groups: int, together: int, seed: int) -> list[int]:
    """The calls' places as they were called in 20 rounds."""
    order: list[int] = []
    calls = [lambda _, place=place: order.append(place) for place in range(groups * together)]
    interleaved(calls, repetitions=20, together=together, seed=seed)
    return order


def test_each_round_has_an_order_of_its_own_and_no_call_follows_itself() -> None:
    order = order_of(4, together=1, seed=3)
    rounds = [tuple(order[start : start + 4]) for start in range(0, 80, 4)]
    assert all(sorted(each) == [0, 1, 2, 3] for each in rounds)
    assert len(set(rounds)) > 5
    assert all(one != next_one for one, next_one in pairwise(order))
    assert order == order_of(4, together=1, seed=3) != order_of(4, together=1, seed=4)


def test_calls_that_belong_together_stay_together() -> None:
    order = order_of(3, together=2, seed=0)
    pairs = list(zip(order[::2], order[1::2], strict=True))
    assert set(pairs) == {(0, 1), (2, 3), (4, 5)}
    assert all(one != next_one for one, next_one in pairwise(pairs))


def test_warming_up_ends_by_rounds_or_by_time() -> None:
    calls: list[int] = []
    warm_up([calls.append], rounds=7, seconds=60)
    assert calls == list(range(7))
    assert warm_up([lambda _: time.sleep(0.002)], rounds=1000, seconds=0.0) >= 0.002

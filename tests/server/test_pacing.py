"""How many requests are refused at once, in virtual time; and what a thread's run delay is."""

import os
import sys
import time
from collections.abc import Iterable
from threading import Event, Thread

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxel_server.core.pacing import RefusalPace
from taxel_server.core.policy import SLICE_S
from taxel_server.core.run_delay import RunDelay


def refusals(pace: RefusalPace, times: Iterable[float]) -> dict[int, int]:
    """How many refusals each slice had, where a request is always there: no pause, no wait."""
    given: dict[int, int] = {}
    paused_until = 0.0
    for now in times:
        if now < paused_until:
            continue
        pause = pace.refused(now)
        assert 0 <= pause <= SLICE_S
        paused_until = now + pause
        number = int(now / SLICE_S)
        given[number] = given.get(number, 0) + 1
    return given


def every(microseconds: float, seconds: float) -> list[float]:
    return [count * microseconds / 1e6 for count in range(1, int(seconds * 1e6 / microseconds))]


def test_with_a_core_all_are_refused_at_once() -> None:
    pace = RefusalPace(lambda: 0.0)
    # Ten in a millisecond: eight in a slice at first, four times as many after each look.
    assert sum(refusals(pace, every(100, 0.1)).values()) == pytest.approx(8 * 0.1 / SLICE_S, rel=0.1)
    refusals(pace, [0.1 + moment for moment in every(100, 0.3)])
    times = [0.4 + moment for moment in every(100, 1)]
    assert sum(refusals(pace, times).values()) == len(times)


def test_without_a_core_two_are_refused_in_a_slice_after_a_short_while() -> None:
    now = 0.0

    def waits_half_the_time() -> float:
        return now / 2

    pace = RefusalPace(waits_half_the_time)
    given: list[int] = []
    paused_until = 0.0
    for now in every(10, 1):
        if now >= paused_until:
            paused_until = now + pace.refused(now)
            given.append(int(now / SLICE_S))
    late = [number for number in given if number >= 30]
    assert len(late) == pytest.approx(2 * (1 / SLICE_S - 30), rel=0.05)


def test_where_the_system_does_not_tell_two_are_refused_in_a_slice() -> None:
    given = refusals(RefusalPace(lambda: None), every(100, 1))
    assert sum(given.values()) == pytest.approx(2 / SLICE_S, rel=0.05)


def test_it_reads_on_soon_after_the_core_is_there_again() -> None:
    delay = 0.0
    pace = RefusalPace(lambda: delay)
    for now in every(100, 0.4):
        delay = now
        pace.refused(now)
    assert sum(refusals(pace, [0.4 + moment for moment in every(100, 0.05)]).values()) < 50
    times = [0.9 + moment for moment in every(100, 0.4)]
    refusals(pace, [0.45 + moment for moment in every(100, 0.4)])
    assert sum(refusals(pace, times).values()) == len(times)


@given(st.lists(st.tuples(st.floats(1e-6, 0.1), st.floats(0, 1) | st.none()), min_size=1, max_size=300))
def test_two_in_a_slice_are_never_held_up(events: list[tuple[float, float | None]]) -> None:
    now, delay = 0.0, 0.0
    share: float | None = 0.0
    pace = RefusalPace(lambda: None if share is None else delay)
    for step, share in events:
        now += step
        delay += step * (share or 0.0)
        pause = pace.refused(now)
        assert 0 <= pause <= SLICE_S
        if step >= SLICE_S:
            assert pause == 0


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")
def test_a_thread_that_shares_a_core_has_waited_for_it() -> None:
    allowed = os.sched_getaffinity(0)
    stop = Event()
    started = Event()

    def work() -> None:
        os.sched_setaffinity(0, {min(allowed)})
        started.set()
        while not stop.is_set():
            sum(range(10_000))

    threads = [Thread(target=work, daemon=True) for _ in range(2)]
    for thread in threads:
        thread.start()
    assert started.wait(10)
    delays = [RunDelay(thread) for thread in threads]
    try:
        ends = time.monotonic() + 10
        while sum(delay.seconds() or 0.0 for delay in delays) < 0.01:
            assert time.monotonic() < ends
            time.sleep(0.01)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    # Python may have joined a thread a moment before the system has ended it.
    ends = time.monotonic() + 10
    while any(delay.seconds() is not None for delay in delays):
        assert time.monotonic() < ends

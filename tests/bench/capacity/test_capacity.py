"""The search for a server's capacity, and one against a real server."""

import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxel_bench.capacity.command import generator
from taxel_bench.capacity.search import CLOSE, Attempt, find_capacity, result_of
from taxel_bench.capacity.service_time import measure_service_time
from taxel_models.shipped import shipped_repository


def attempt(fingers: int, *, fits: bool, late: float = 0.0, others: float = 0.0) -> Attempt:
    return Attempt(fingers, fits, 1.0, late, {}, 0.5, others)


@given(capacity=st.integers(0, 5000), most=st.integers(1, 4096))
def test_the_search_ends_close_below_the_capacity(capacity: int, most: int) -> None:
    found, attempts = find_capacity(lambda fingers: attempt(fingers, fits=fingers <= capacity), most)
    assert found <= capacity
    assert all(1 <= each.fingers <= most for each in attempts)
    if capacity >= most:
        assert found == most
    elif capacity:
        assert capacity < max(CLOSE * found, found + 1)
    assert len(attempts) <= 40


def test_what_does_not_fit_once_is_tried_again() -> None:
    tried: list[int] = []

    def ask(fingers: int) -> Attempt:
        tried.append(fingers)
        return attempt(fingers, fits=fingers <= 100 and (fingers != 64 or tried.count(64) == 2))

    assert 91 <= find_capacity(ask, 4096)[0] <= 100


def test_a_number_is_tried_until_nothing_else_ran() -> None:
    tried: list[int] = []

    def ask(fingers: int) -> Attempt:
        tried.append(fingers)
        return attempt(fingers, fits=fingers < 64, others=0.4 if tried.count(fingers) < 3 else 0.0)

    found, attempts = find_capacity(ask, 4096)
    assert found < 64
    assert tried.count(64) == 4
    assert result_of("xgb", "lane", 100, found, attempts, 4096)["verdict"] == "VALID"
    busy = find_capacity(lambda fingers: attempt(fingers, fits=fingers < 64, others=0.4), 4096)
    assert [each.fingers for each in busy[1]].count(64) == 5
    assert result_of("xgb", "lane", 100, *busy, 4096)["verdict"] == "INVALID"


def test_a_late_generator_makes_a_row_invalid() -> None:
    good = [attempt(64, fits=True), attempt(70, fits=False), attempt(70, fits=False)]
    assert result_of("xgb", "lane", 100, 64, good, 4096)["verdict"] == "VALID"
    late = [attempt(64, fits=True), attempt(70, fits=False, late=0.2)]
    assert "woke late for 20%" in result_of("xgb", "lane", 100, 64, late, 4096)["reasons"][0]
    busy = [attempt(64, fits=True), attempt(70, fits=False, others=0.4)]
    assert "other programs took 0.4" in result_of("xgb", "lane", 100, 64, busy, 4096)["reasons"][0]
    # What is slow for the generator's sake is no matter where the fewest that do not fit are sound.
    assert (
        result_of("xgb", "lane", 100, 64, [*good, attempt(128, fits=False, late=0.2)], 4096)["reasons"]
        == []
    )
    assert "more were not tried" in result_of("xgb", "lane", 100, 64, good[:1], 64)["reasons"][0]


@pytest.mark.long
def test_a_real_server_is_asked_over_both_transports(tmp_path: Path) -> None:
    shutil.copytree(shipped_repository() / "xgb", tmp_path / "xgb")
    with generator(tmp_path, 2, 0.1) as asking:
        for transport in ("lane", "zenoh"):
            # How fast it is depends on the machine; that all steps are answered does not.
            done = asking.try_fingers("xgb", transport, 100.0, 3)
            assert done.fingers == 3
            assert done.p99_ms is not None
            assert done.errors == {}
            service = measure_service_time(asking, "xgb", transport, 0.3)
            assert service.of(1000) > 0

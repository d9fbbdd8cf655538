"""When a client without a lane looks for one, and who does so."""

import pytest

from taxel.lane import lookup
from taxel.lane.lookup import LaneLookup


class Lane:
    """A lane that only knows whether it is open."""

    address = "unix:/x"

    def __init__(self) -> None:
        self.is_open = True

    def close(self) -> None:
        self.is_open = False


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time, which stands still until it is set."""
    time = [0.0]
    monkeypatch.setattr(lookup.time, "monotonic", lambda: time[0])
    return time


@pytest.mark.parametrize(("there_is_none", "looks"), [(True, 9), (False, 1200)])
def test_it_looks_ever_less_often_while_the_server_answers(
    now: list[float], there_is_none: bool, looks: int
) -> None:
    lanes: LaneLookup[Lane] = LaneLookup()
    looked = 0
    # In 300 s: at 0, 2, 6, 14, 30, 62 s and then each minute; or four times each second.
    for number in range(2400):
        now[0] = number / 8
        if lanes.begin():
            looked += 1
            lanes.end(None, there_is_none=there_is_none)
    assert looked == looks


def test_one_caller_looks_at_a_time_and_one_opens_a_lost_lane_again(now: list[float]) -> None:
    lanes: LaneLookup[Lane] = LaneLookup()
    first, second = Lane(), Lane()
    assert [lanes.begin(), lanes.begin(), lanes.looking] == [True, False, True]
    lanes.end(first)
    assert (lanes.lane, lanes.begin()) == (first, False)
    assert [lanes.lost(first), lanes.lost(first), lanes.looking] == [True, False, True]
    assert not first.is_open
    lanes.end(second)
    assert not lanes.lost(first)
    assert lanes.lane is second


def test_what_is_found_after_the_end_is_closed(now: list[float]) -> None:
    lanes: LaneLookup[Lane] = LaneLookup()
    late = Lane()
    assert lanes.begin()
    lanes.close()
    lanes.end(late)
    assert (late.is_open, lanes.lane) == (False, None)
    now[0] = 1000
    assert not lanes.begin()

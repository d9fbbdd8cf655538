"""How many requests a connection has under way, and what it refuses itself."""

from threading import Thread

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxel.errors import Internal, ResourceExhausted
from taxel.remote.open_requests import Ended, OpenRequests

ANSWER = b"counts"


def begun(requests: OpenRequests, number: int, size: int = 100) -> list[Ended]:
    return [requests.begin(size) for _ in range(number)]


def room_in(requests: OpenRequests, most: int = 1000) -> int:
    """How many more may be sent; they end in a way that changes no limit."""
    sent = []
    try:
        for _ in range(most):
            sent.append(requests.begin(100))
    except ResourceExhausted:
        pass
    for end in sent:
        end(None)
    return len(sent)


def test_a_signals_handler_may_send_one_while_another_is_counted() -> None:
    """A handler runs in the middle of whatever its thread does, also where that holds a lock."""
    told: list[int] = []

    def count() -> None:
        requests = OpenRequests()
        with requests._lock:
            requests.begin(100)(None)
        told.append(room_in(requests))

    thread = Thread(target=count, daemon=True)
    thread.start()
    thread.join(10)
    assert told == [1000]


def test_there_is_no_limit_before_the_server_has_refused() -> None:
    requests = OpenRequests()
    begun(requests, 5000)
    assert room_in(requests) == 1000


def test_a_refusal_limits_what_is_under_way_to_half_of_what_the_server_holds() -> None:
    requests = OpenRequests()
    sent = begun(requests, 10)
    sent.pop()(ResourceExhausted("the queue is full", 8))
    with pytest.raises(ResourceExhausted, match="9 requests of this connection are under way"):
        requests.begin(100)
    for _ in range(5):
        sent.pop()(Internal("failed"))
        assert room_in(requests) == 0
    sent.pop()(Internal("failed"))
    assert room_in(requests) == 1


def test_the_limit_grows_by_one_for_as_many_answers() -> None:
    requests = OpenRequests()
    first, *others = begun(requests, 4)
    first(ResourceExhausted("the queue is full", 6))
    for _ in range(3):
        others.pop(0)(ANSWER)
        others += begun(requests, 1)
    assert room_in(requests) == 1


def test_once_nothing_is_under_way_there_is_no_limit() -> None:
    requests = OpenRequests()
    first, second = begun(requests, 2)
    first(ResourceExhausted("the queue is full", 0))
    assert room_in(requests) == 0
    second(ANSWER)
    assert room_in(requests) == 1000


def test_a_refusal_of_another_kind_limits_nothing() -> None:
    requests = OpenRequests()
    first, *_ = begun(requests, 2)
    first(ResourceExhausted("expected at most 65536 rows"))
    assert room_in(requests) == 1000


def test_a_smaller_request_than_those_refused_is_sent() -> None:
    requests = OpenRequests()
    first, second, *_ = begun(requests, 4, size=1000)
    first(ResourceExhausted("the queue is full", 4))
    (small,) = begun(requests, 1, size=999)
    with pytest.raises(ResourceExhausted, match="4 requests"):
        requests.begin(1000)
    small(ResourceExhausted("the queue is full", 2))
    with pytest.raises(ResourceExhausted):
        requests.begin(999)
    # A large one that is refused later says nothing new of small ones.
    second(ResourceExhausted("the queue is full", 2))
    with pytest.raises(ResourceExhausted):
        requests.begin(999)
    begun(requests, 1, size=998)


def test_a_request_ends_once() -> None:
    requests = OpenRequests()
    first, second, _ = begun(requests, 3)
    first(ResourceExhausted("the queue is full", 4))
    second(ANSWER)
    second(ANSWER)
    assert room_in(requests) == 1


@given(share=st.integers(1, 20), wanted=st.integers(1, 60), rounds=st.integers(1, 20))
def test_a_server_with_a_fixed_share_refuses_no_more_than_the_growth_asks_for(
    share: int, wanted: int, rounds: int
) -> None:
    requests, held, refused = OpenRequests(), list[Ended](), 0
    for number in range(rounds):
        for _ in range(wanted):
            try:
                end = requests.begin(100)
            except ResourceExhausted:
                break
            if len(held) < share:
                held.append(end)
            else:
                end(ResourceExhausted("the queue is full", len(held)))
                refused += 1 if number else 0
        held.pop(0)(ANSWER)
    # In the first round the client does not know the share; later it tries one more after so many answers.
    assert refused <= rounds

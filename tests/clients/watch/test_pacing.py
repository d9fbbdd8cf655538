"""Updates for a viewer that is slower than the data."""

from hypothesis import given
from hypothesis import strategies as st

from taxel_watch.pacing import IN_FLIGHT, Pacing


def happen(pacing: Pacing, due: bool) -> None:
    """A moment of a viewer's life: True is an update that is due, False an update that it has drawn."""
    if not due:
        pacing.note_drawn()
    elif pacing.may_send():
        pacing.note_sent()


def run(events: list[bool]) -> Pacing:
    pacing = Pacing()
    for due in events:
        happen(pacing, due)
    return pacing


@given(st.lists(st.booleans(), max_size=200))
def test_each_due_update_is_sent_or_dropped_and_few_are_ever_under_way(events: list[bool]) -> None:
    pacing, due = Pacing(), 0
    for event in events:
        happen(pacing, event)
        due += event
        assert pacing.sent + pacing.dropped == due
        assert 0 <= pacing.sent - pacing.drawn <= IN_FLIGHT


def test_a_viewer_that_draws_at_once_misses_nothing() -> None:
    pacing = run([True, False] * 50)
    assert (pacing.sent, pacing.drawn, pacing.dropped) == (50, 50, 0)


def test_a_viewer_that_draws_nothing_gets_no_more() -> None:
    pacing = run([True] * 50)
    assert (pacing.sent, pacing.dropped) == (IN_FLIGHT, 50 - IN_FLIGHT)


def test_a_viewer_cannot_have_drawn_what_it_did_not_get() -> None:
    pacing = run([False] * 9 + [True] * 5)
    assert pacing.sent == IN_FLIGHT

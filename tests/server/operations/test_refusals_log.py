"""The log of refusals: one line for each kind and client in a while, and every refusal counted."""

import json
import logging
import sys
from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxel.errors import InvalidArgument, RequestError, ResourceExhausted
from taxel_server.core.refusals import OTHERS, Refusals
from taxel_server.operations.liveness import STUCK_S, Liveness
from taxel_server.operations.log_format import _JsonFormatter, _TextFormatter

ERRORS: tuple[type[RequestError], ...] = (InvalidArgument, ResourceExhausted)
EVENTS = st.lists(
    st.tuples(st.floats(0, 6), st.sampled_from(ERRORS), st.sampled_from(["a", "b"])), max_size=60
)


class Records(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.records: list[logging.LogRecord] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)


@given(EVENTS)
def test_every_refusal_is_counted_and_each_kind_is_logged_once_in_ten_seconds(
    events: list[tuple[float, type[RequestError], str]],
) -> None:
    now = 0.0
    refusals = Refusals(lambda: now)
    log, lines = logging.getLogger("taxel_server.refusals"), Records()
    log.addHandler(lines)
    logged: dict[tuple[str, str], list[float]] = {}
    told: Counter[tuple[str, str]] = Counter()
    counted: Counter[tuple[str, str]] = Counter()
    try:
        for wait, error, client in events:
            now += wait
            before = len(lines.records)
            refusals.add(error("wrong"), client=client, request_id="7")
            kind = error.code, client
            counted[kind] += 1
            if len(lines.records) > before:
                logged.setdefault(kind, []).append(now)
                fields = lines.records[-1].fields
                assert (fields["code"], fields["client"], fields["request_id"]) == (*kind, "7")
                told[kind] += 1 + fields.get("suppressed", 0)
    finally:
        log.removeHandler(lines)
    assert refusals.counts() == [(*kind, count) for kind, count in sorted(counted.items())]
    for kind, times in logged.items():
        assert all(later - earlier >= 10 for earlier, later in pairwise(times))
        # What was suppressed since the last line is told by the next one.
        assert told[kind] <= counted[kind]
    assert logged.keys() == counted.keys()


def test_strangers_do_not_fill_the_memory() -> None:
    refusals = Refusals()
    logging.disable(logging.CRITICAL)
    try:
        for number in range(1000):
            refusals.add(InvalidArgument("wrong"), client=f"client {number}")
    finally:
        logging.disable(logging.NOTSET)
    counts = {client: count for _, client, count in refusals.counts()}
    assert len(counts) == 257
    assert counts[OTHERS] == 1000 - 256


@given(st.text(max_size=40), st.text(max_size=20))
def test_a_client_cannot_begin_a_line_of_the_log(message: str, client: str) -> None:
    record = logging.LogRecord("taxel", logging.WARNING, "", 0, "refused: %s", (message,), None)
    record.fields = {"client": client}
    text, line = _TextFormatter().format(record), _JsonFormatter().format(record)
    assert len(text.splitlines()) == len(line.splitlines()) == 1
    assert json.loads(line)["client"] == client


def test_an_exception_is_told_in_both_forms() -> None:
    try:
        raise ZeroDivisionError("layout")
    except ZeroDivisionError:
        record = logging.LogRecord("taxel", logging.ERROR, "", 0, "failed", (), sys.exc_info())
    assert "ZeroDivisionError: layout" in _TextFormatter().format(record)
    assert "ZeroDivisionError: layout" in json.loads(_JsonFormatter().format(record))["exception"]


@pytest.mark.parametrize(
    ("progress", "live"),
    [((True, 3, 7), False), ((True, 3, 8), True), ((True, 0, 7), True), ((False, 0, 7), False)],
)
def test_a_server_is_live_while_it_is_idle_or_answers(progress: tuple[bool, int, int], live: bool) -> None:
    """Three requests waited, and seven had been answered, a while ago."""
    now, state = 0.0, (True, 3, 7)
    liveness = Liveness(lambda: state, lambda: now)
    assert liveness.is_live()
    now, state = STUCK_S + 1, progress
    assert liveness.is_live() == live

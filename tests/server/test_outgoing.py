"""Answers that wait for a client that reads slowly: all are given, in bounded memory."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue

import pytest
import zenoh

from taxel_bench.plain_client import client_config
from taxel_server.transports import outgoing
from taxel_server.transports.outgoing import Outgoing
from taxel_server.transports.zenoh_session import open_session

_ANSWER = bytes(10**6)
_ASKED = 40
_READ_S = 0.02
"""Between two answers that the client reads: 50 MB/s, and the connection takes more than that."""


@contextmanager
def asking(endpoint: str, ended: Callable[[bool], None]) -> Iterator[SimpleQueue[zenoh.Query]]:
    """Queries of a client that asks all at once and reads slowly; `ended` learns if each is answered."""
    queries: SimpleQueue[zenoh.Query] = SimpleQueue()

    def ask(session: zenoh.Session) -> None:
        replies: list[bool] = []

        def read(reply: zenoh.Reply) -> None:
            replies.append(reply.ok is not None and len(reply.ok.payload) == len(_ANSWER))
            time.sleep(_READ_S)

        handler = zenoh.handlers.Callback(read, lambda: ended(replies == [True]), indirect=False)
        session.get("asked", handler, timeout=30.0)

    with open_session([endpoint]) as server, zenoh.open(client_config(endpoint)) as client:
        taken = zenoh.handlers.Callback(queries.put, indirect=False)
        server.declare_queryable("asked", taken, complete=True)
        for _ in range(_ASKED):
            ask(client)
        yield queries


@pytest.mark.parametrize(("limit", "value"), [("_MOST_BYTES", 4 * len(_ANSWER)), ("_MOST_ANSWERS", 4)])
def test_beyond_what_may_wait_nothing_is_lost(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, limit: str, value: int
) -> None:
    monkeypatch.setattr(outgoing, limit, value)
    answered: list[bool] = []
    most = 0
    with asking(endpoint, answered.append) as queries:
        giving = Outgoing()
        for _ in range(_ASKED):
            giving.give("slow", queries.get(timeout=30.0), _ANSWER)
            backlog = giving._slow.get("slow")
            most = max(most, 0 if backlog is None else len(backlog.waiting))
        giving.close(30.0)
        while len(answered) < _ASKED:
            time.sleep(0.001)
    assert answered == [True] * _ASKED
    assert most == 4


def test_clients_beyond_those_with_a_thread_wait_for_each_other(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outgoing, "_MOST_CLIENTS", 0)
    answered: list[bool] = []
    with asking(endpoint, answered.append) as queries:
        giving = Outgoing()
        for _ in range(_ASKED):
            giving.give("slow", queries.get(timeout=30.0), _ANSWER)
            assert not giving._slow
        while len(answered) < _ASKED:
            time.sleep(0.001)
    assert answered == [True] * _ASKED

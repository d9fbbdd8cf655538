"""A server that is stopped, as in a debugger, reads nothing: a client's call still ends at its deadline."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue

import numpy as np
import pytest

import taxel
from taxel.errors import RequestError, ServerLost
from taxel.remote.core import with_grace
from taxel.remote.options import Transport
from taxel_bench.server_process import RunningServer, running_server_process

_TIMEOUT_S = 1.0
_LATE_S = 3.0
"""How much later than at its deadline a call may end here, where other tests run, too."""

_ROWS = 60_000
"""3 MB of windows, which no connection keeps for a server that does not read."""


@pytest.fixture(scope="module")
def server(repository: Path) -> Iterator[RunningServer]:
    with running_server_process(repository) as running:
        yield running


@contextmanager
def stopped(server: RunningServer) -> Iterator[None]:
    os.kill(server.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(server.pid, signal.SIGCONT)


# zenoh keeps some of the requests, so that the third one waits to be sent.
@pytest.mark.parametrize(("transport", "calls"), [("lane", 2), ("zenoh", 4)])
def test_a_request_that_cannot_be_sent_ends_at_its_deadline(
    server: RunningServer, transport: Transport, calls: int
) -> None:
    windows = np.zeros((_ROWS, 12), np.float32)
    with taxel.connect(server.endpoint, timeout=_TIMEOUT_S, transport=transport) as source:
        predictor = source.predictor("wide")
        expected = predictor.predict(windows, timeout=20.0)
        with stopped(server):
            for _ in range(calls):
                began = time.monotonic()
                with pytest.raises(RequestError):
                    predictor.predict(windows)
                assert time.monotonic() - began < with_grace(_TIMEOUT_S) + _LATE_S
        np.testing.assert_array_equal(predictor.predict(windows, timeout=20.0), expected)


def test_what_is_asked_while_a_connection_is_being_closed_is_lost_at_once(server: RunningServer) -> None:
    windows = np.zeros((_ROWS, 12), np.float32)
    with taxel.connect(server.endpoint, timeout=0.25, transport="zenoh") as source:
        predictor = source.predictor("wide")
        outcome: SimpleQueue[bytes | RequestError] = SimpleQueue()
        with stopped(server):
            while source.connection.connected:
                with pytest.raises(RequestError):
                    predictor.predict(windows)
            # zenoh would take them, and end some of them only at their timeout.
            began = time.monotonic()
            with pytest.raises(ServerLost):
                source.get("taxel/v2", timeout=20.0)
            source.connection.send("taxel/v2", None, 20.0, outcome.put)
            assert isinstance(outcome.get(), ServerLost)
            assert time.monotonic() - began < _LATE_S
        assert predictor.predict(windows, timeout=20.0).shape == (_ROWS, 21)


@pytest.mark.parametrize(("timeout", "whole"), [(0.02, 0.025), (1.0, 1.25), (5.0, 5.25), (60.0, 60.25)])
def test_a_refusal_has_a_quarter_of_the_timeout_more(timeout: float, whole: float) -> None:
    assert with_grace(timeout) == pytest.approx(whole)

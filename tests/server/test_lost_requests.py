"""No request is lost, whatever its answer's size; and clients that stop reading silence nobody.

The server runs in a process of its own: zenoh's threads are set once in a process.
"""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import zenoh

import taxel
from taxel.protocol import model_key, pack_infer_request
from taxel_bench.chaos.stopped import PAST_LEASES_S, stopped_clients
from taxel_bench.plain_client import client_config
from taxel_bench.server_process import running_server

_WAIT_S = 3.0
"""What another client waits at most; where zenoh was deafened, it waited for 10 s."""


_SLOWLY_READ = 60
"""Requests of a slow reader: as many as the server lets a client queue. Their answers have 5 MB."""

_READ_S = 0.02
"""Between two answers that it reads: 4 MB/s."""


class _SlowReader:
    """A client, written with zenoh alone, that reads its answers one by one, and not at once."""

    def __init__(self, endpoint: str) -> None:
        self._session = zenoh.open(client_config(endpoint))
        self.read = 0
        self.outcomes: list[str] = []

    def __enter__(self) -> "_SlowReader":
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def ask(self) -> None:
        """Send all requests."""
        payload = pack_infer_request(np.zeros((1000, 12), dtype=np.float32))
        for _ in range(_SLOWLY_READ):
            self._ask(payload)

    def _ask(self, payload: bytes) -> None:
        outcome = "empty"

        def read(reply: zenoh.Reply) -> None:
            nonlocal outcome
            outcome = "answered" if reply.ok is not None else "refused"
            self.read += 1
            time.sleep(_READ_S)

        handler = zenoh.handlers.Callback(read, lambda: self.outcomes.append(outcome), indirect=False)
        key = model_key("taxel", "wide", "1", "infer")
        self._session.get(key, handler, payload=payload, timeout=20.0)

    def wait(self) -> None:
        """Until all requests have ended."""
        while len(self.outcomes) < _SLOWLY_READ:
            time.sleep(0.01)


@pytest.fixture(scope="module")
def server(repository: Path) -> Iterator[str]:
    with running_server(repository) as endpoint:
        yield endpoint


def test_fresh_connections_lose_no_answer_that_nearly_fills_a_batch(server: str) -> None:
    # zenoh sends at most 65,535 bytes at once: the answers to 700 and 1024 windows are about as large.
    for _ in range(40):
        with taxel.connect(server, transport="zenoh") as source:
            predictor = source.predictor("wide")
            for rows in (700, 1024) * 20:
                assert predictor.predict(np.zeros((rows, 12), dtype=np.float32)).shape == (rows, 21)


@pytest.mark.parametrize("shared_memory", [False, True])
def test_no_size_is_lost(repository: Path, shared_memory: bool) -> None:
    rng = np.random.default_rng(7)
    sizes = [1, 2, 63, 64, 65, 255, 256, 257, 779, 780, 781, 1023, 1025, 4096, 65_536]
    sizes += rng.integers(1, 2000, 200).tolist()
    choice = "--shared-memory" if shared_memory else "--no-shared-memory"
    with (
        running_server(repository, choice) as endpoint,
        taxel.connect(endpoint, shared_memory=shared_memory, transport="zenoh") as warm,
    ):
        kept = warm.predictor("wide")
        for rows in sizes:
            windows = rng.normal(size=(rows, 12)).astype(np.float32)
            expected = kept.predict(windows)
            assert expected.shape == (rows, 21)
            with taxel.connect(endpoint, shared_memory=shared_memory, transport="zenoh") as fresh:
                np.testing.assert_array_equal(fresh.predictor("wide").predict(windows), expected)


@pytest.mark.parametrize("stopped", [1, 12])
def test_clients_that_stop_reading_silence_nobody(server: str, stopped: int) -> None:
    with (
        taxel.connect(server, timeout=_WAIT_S, transport="zenoh") as source,
        stopped_clients(server, "wide", stopped),
    ):
        predictor = source.predictor("wide")
        end = time.monotonic() + PAST_LEASES_S
        while time.monotonic() < end:
            assert predictor.predict(np.zeros((1, 12), dtype=np.float32)).shape == (1, 21)
            time.sleep(0.005)


def test_a_client_that_reads_slowly_loses_nothing_and_holds_nobody_up(server: str) -> None:
    with _SlowReader(server) as slow, taxel.connect(server, timeout=_WAIT_S, transport="zenoh") as source:
        predictor = source.predictor("wide")
        slow.ask()
        # More than Linux keeps for a connection: the others wait in the server.
        while slow.read < 5:
            time.sleep(0.001)
        before = slow.read
        for _ in range(20):
            assert predictor.predict(np.zeros((1, 12), dtype=np.float32)).shape == (1, 21)
        read_meanwhile = slow.read - before
        slow.wait()
    # If each answer waited for one of the slow reader's, as many would have been read.
    assert read_meanwhile < 20
    assert slow.outcomes == ["answered"] * _SLOWLY_READ


def test_stopping_gives_a_slow_reader_its_answers(repository: Path) -> None:
    with ExitStack() as clients:
        with running_server(repository) as endpoint:
            slow = clients.enter_context(_SlowReader(endpoint))
            slow.ask()
            while slow.read < 5:
                time.sleep(0.001)
        # The server was asked to stop, and has ended.
        slow.wait()
    assert slow.outcomes == ["answered"] * _SLOWLY_READ

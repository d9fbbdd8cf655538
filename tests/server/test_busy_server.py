"""A server that computes: still answers, refuses, keeps deadlines, and stops without losing a query."""

import asyncio
import re
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from queue import Queue
from threading import Event

import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray

import taxel
from taxel.errors import DeadlineExceeded, RequestError, ResourceExhausted, Unavailable
from taxel.lane.connection import LaneConnection
from taxel.protocol import pack_infer_request, unpackb
from taxel.remote import Transport
from taxel.remote.async_source import AsyncSource
from taxel_bench.plain_client import client_config
from taxel_server import engine as engine_module
from taxel_server.core import metadata
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.runtimes import EvaluatorInfo, Runtime
from taxel_server.service import Service
from taxel_server.transports import lane_transport
from taxel_server.transports.memory import MemoryServer
from taxel_server.transports.zenoh_clients import ANONYMOUS, ZenohClients
from taxel_server.transports.zenoh_session import open_session

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]


def client_session(place: str) -> zenoh.Session:
    """A client's session, without the project's client."""
    return zenoh.open(client_config(place))


@contextmanager
def two_sessions(place: str) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """A server's session and a client's."""
    server = open_session([place])
    client = client_session(place)
    try:
        yield server, client
    finally:
        client.close()
        server.close()


class Gate:
    """A real runtime that waits to be let through."""

    def __init__(self, runtime: Runtime) -> None:
        self.runtime = runtime
        self.features = runtime.features
        self.entered, self.opened = Event(), Event()
        self.opened.set()

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        self.entered.set()
        assert self.opened.wait(10)
        return self.runtime.evaluate(windows)

    def evaluator(self, rows: int) -> EvaluatorInfo:
        return self.runtime.evaluator(rows)

    def shut(self) -> None:
        self.opened.clear()
        self.entered.clear()


@pytest.fixture
def gated(repository: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Engine, Gate]]:
    """An engine whose newest `skin` can be held back."""
    opening = engine_module.open_runtime
    gates = {}

    def open_gate(artifact: engine_module.artifacts.Artifact, threads: int) -> Runtime:
        gate = gates[artifact.manifest.version] = Gate(opening(artifact, threads))
        return gate

    monkeypatch.setattr(engine_module, "open_runtime", open_gate)
    engine = Engine(repository)
    engine.load_all()
    yield engine, gates["10"]
    gates["10"].opened.set()


@pytest.mark.parametrize("transport", ["zenoh", "lane"])
def test_it_answers_refuses_and_keeps_deadlines(
    gated: tuple[Engine, Gate], start: ServerStarter, make_windows: WindowMaker, transport: Transport
) -> None:
    engine, gate = gated
    place = start(engine, max_queue_rows=16, max_request_rows=8)
    gate.shut()
    with taxel.connect(place, transport=transport) as client, ThreadPoolExecutor(1) as pool:
        predictor = client.predictor("skin")
        running = pool.submit(predictor.predict, make_windows(4))
        assert gate.entered.wait(10)
        with pytest.raises(DeadlineExceeded):
            predictor.predict(make_windows(3), timeout=0.01)
        with pytest.raises(ResourceExhausted, match=r"the queue is full: [47] of 16 rows"):
            predictor.predict(make_windows(6))
        assert client.ready()
        assert len(client.models()) == 3
        gate.opened.set()
        np.testing.assert_array_equal(running.result(), engine.model("skin").evaluate(make_windows(4)))
        assert predictor.predict(make_windows(8)).shape == (8, 21)
        counted = unpackb(client.get("taxel/v2/models/skin/stats"))
    # A client that waits no longer says so, or closes its connection: the server drops what it asked.
    assert counted["errors"] == {"RESOURCE_EXHAUSTED": 1}
    assert counted["cancelled"] == {"requests": 1, "rows": 3}


def test_a_client_sends_no_more_than_the_server_lets_it_queue(
    gated: tuple[Engine, Gate], start: ServerStarter, make_windows: WindowMaker
) -> None:
    engine, gate = gated
    place = start(engine, max_queue_requests=8)
    gate.shut()
    # The receiver itself evaluates a single window, and takes no others meanwhile.
    payload, key = pack_infer_request(make_windows(16)), "taxel/v2/models/skin/infer"
    answers: Queue[bytes | RequestError] = Queue()
    with taxel.connect(place, transport="zenoh") as client:

        def send(requests: int) -> None:
            for _ in range(requests):
                client.connection.send(key, payload, 10.0, answers.put)

        send(1)
        assert gate.entered.wait(10)
        send(19)
        # A client alone has half of the queue.
        refusals = [answers.get(timeout=10) for _ in range(16)]
        # The client knows from the first refusal on, and may not send the last ones.
        by_server = [one for one in refusals if "was not sent" not in str(one)]
        assert {getattr(refusal, "open_requests", None) for refusal in by_server} == {4}
        send(5)
        unsent = [answers.get(timeout=10) for _ in range(5)]
        assert all("this one was not sent" in str(refusal) for refusal in unsent)
        gate.opened.set()
        assert all(isinstance(answers.get(timeout=10), bytes) for _ in range(4))
        send(1)
        assert isinstance(answers.get(timeout=10), bytes)
        counted = unpackb(client.get("taxel/v2/models/skin/stats"))
    assert counted["errors"] == {"RESOURCE_EXHAUSTED": len(by_server)}


@pytest.mark.parametrize("transport", ["zenoh", "lane"])
@pytest.mark.parametrize(("drain_seconds", "finished"), [(60.0, True), (0.0, False)])
def test_stopping_answers_every_query(
    gated: tuple[Engine, Gate],
    endpoint: str,
    make_windows: WindowMaker,
    drain_seconds: float,
    finished: bool,
    transport: Transport,
) -> None:
    engine, gate = gated
    service = Service(
        engine, ServerOptions(repository=Path("unused"), listen=(endpoint,), drain_seconds=drain_seconds)
    ).start()
    gate.shut()
    windows = make_windows(5)
    with taxel.connect(endpoint, transport=transport) as client, ThreadPoolExecutor(9) as pool:
        predictor = client.predictor("skin")
        running = pool.submit(predictor.predict, windows)
        assert gate.entered.wait(10)
        queued = [pool.submit(predictor.predict, windows) for _ in range(7)]
        while service.queued_rows < 8 * 5:
            assert client.ready()
        closing = pool.submit(service.close)
        while client.ready():
            assert not closing.done()
        with pytest.raises(Unavailable, match="the server is stopping"):
            predictor.predict(windows)
        gate.opened.set()
        expected = engine.model("skin").evaluate(windows)
        np.testing.assert_array_equal(running.result(), expected)
        for answer in queued:
            if finished:
                np.testing.assert_array_equal(answer.result(), expected)
            else:
                with pytest.raises(Unavailable, match="the server is stopping"):
                    answer.result()
        assert closing.result()


def test_who_floods_is_refused_and_others_are_not(
    gated: tuple[Engine, Gate], start: ServerStarter, make_windows: WindowMaker
) -> None:
    engine, gate = gated
    place = start(engine, max_queue_rows=1200, max_request_rows=400)
    gate.shut()
    with (
        taxel.connect(place, transport="zenoh") as flooder,
        taxel.connect(place, transport="zenoh") as polite,
        ThreadPoolExecutor(8) as pool,
    ):
        large = make_windows(300)
        flooding, asking = flooder.predictor("skin"), polite.predictor("skin")
        running = [pool.submit(flooding.predict, large) for _ in range(2)]
        assert gate.entered.wait(10)
        while unpackb(flooder.get("taxel/v2/models/skin/stats"))["errors"] == {}:
            running.append(pool.submit(flooding.predict, large))
        served = [pool.submit(asking.predict, make_windows(rows)) for rows in (1, 150)]
        while pool._work_queue.qsize():
            assert polite.ready()
        gate.opened.set()
        for answer, rows in zip(served, (1, 150), strict=True):
            np.testing.assert_array_equal(
                answer.result(), engine.model("skin").evaluate(make_windows(rows))
            )
        refused = [answer for answer in running if answer.exception() is not None]
        assert refused
        told = r"of 1200 rows, .* of them yours"
        for answer in refused:
            # The client knows from the first refusal on, and may not send the last ones.
            with pytest.raises(ResourceExhausted, match=rf"{told}|this one was not sent"):
                answer.result()
        assert any(re.search(told, str(answer.exception())) for answer in refused)
        assert len(running) - len(refused) == 2


def test_who_is_not_known_shares_with_others_like_that(endpoint: str) -> None:
    told: list[object] = []
    clients = ZenohClients(told.append)
    with two_sessions(endpoint) as (server, client):
        clients.watch(server)
        queryable = server.declare_queryable("t", zenoh.handlers.FifoChannel(8))
        ends = time.monotonic() + 10
        while str(client.info.zid()) not in clients.connected:
            assert time.monotonic() < ends
            time.sleep(0.01)
        stranger = zenoh.SourceInfo(server.id, 0)
        for source in (zenoh.SourceInfo(client.id, 0), stranger, None, zenoh.SourceInfo(client.id, 7)):
            client.get("t", source_info=source)
        askers = []
        for _ in range(4):
            with queryable.recv() as query:
                askers.append(clients.asker_of(query))
        session = str(client.info.zid())
        assert askers == [(session, None), (ANONYMOUS, None), (ANONYMOUS, None), (session, (session, 7))]
        client.close()
        ends = time.monotonic() + 10
        while not told:
            assert time.monotonic() < ends
            time.sleep(0.01)
        clients.close()
    assert told == [session]


def test_a_new_session_is_known_from_its_first_query_on(endpoint: str) -> None:
    with two_sessions(endpoint) as (server, first):
        queryable = server.declare_queryable("t", zenoh.handlers.FifoChannel(8))
        clients = ZenohClients(lambda _: None)
        # zenoh tells of `first` here, and of whoever comes later a moment after their first queries.
        clients.watch(server)
        assert clients.asker_of(_asked(first, queryable)).client == str(first.info.zid())
        clients.close()
        with client_session(endpoint) as second:
            # `clients` hears no events any more: it must have asked zenoh.
            assert clients.asker_of(_asked(second, queryable)).client == str(second.info.zid())


def _asked(
    session: zenoh.Session, queryable: zenoh.Queryable[zenoh.handlers.Handler[zenoh.Query]]
) -> zenoh.Query:
    """A query of a session, as it arrives."""
    session.get("t", source_info=zenoh.SourceInfo(session.id, 0))
    return queryable.recv()


def test_requests_of_a_client_that_has_gone_are_not_evaluated(
    gated: tuple[Engine, Gate], endpoint: str, make_windows: WindowMaker
) -> None:
    engine, gate = gated
    service = Service(engine, ServerOptions(listen=(endpoint,))).start()
    gate.shut()
    with taxel.connect(endpoint, transport="zenoh") as staying, ThreadPoolExecutor(4) as pool:
        held = pool.submit(staying.predictor("skin").predict, make_windows(2))
        assert gate.entered.wait(10)
        alone = service.queued_rows
        assert service.lane is not None
        leaving, connection = (
            taxel.connect(endpoint, transport="zenoh"),
            LaneConnection(service.lane.address),
        )
        lost = [pool.submit(leaving.predictor("skin").predict, make_windows(3)) for _ in range(3)]
        for _ in range(3):
            connection.send("v2/models/skin/infer", make_windows(3), 10, 10, spread=False)
        while service.queued_rows < alone + 18:
            assert staying.ready()
        leaving.close()
        connection.close()
        while service.queued_rows > alone:
            assert staying.ready()
        gate.opened.set()
        assert held.result().shape == (2, 21)
        assert all(isinstance(answer.exception(), RequestError) for answer in lost)
        counted = unpackb(staying.get("taxel/v2/models/skin/stats"))
    assert (counted["errors"], counted["cancelled"]) == ({}, {"requests": 6, "rows": 18})
    assert counted["rows"] == 2
    assert service.close()


@pytest.mark.parametrize("transport", ["zenoh", "lane", "memory", "replicas"])
def test_a_cancelled_call_is_dropped_by_the_server(
    gated: tuple[Engine, Gate], endpoint: str, make_windows: WindowMaker, transport: str
) -> None:
    engine, gate = gated
    gate.shut()

    async def main(source: AsyncSource, server: Service | MemoryServer) -> None:
        predictor = await source.predictor("skin")
        held = asyncio.create_task(predictor.predict(make_windows(2)))
        assert await asyncio.to_thread(gate.entered.wait, 10)
        calls = [asyncio.create_task(predictor.predict(make_windows(3))) for _ in range(4)]
        while server.queued_rows < 14:
            await asyncio.sleep(0.001)
        for call in calls[1:]:
            call.cancel()
        await asyncio.gather(*calls[1:], return_exceptions=True)
        async with asyncio.timeout(10):
            while server.queued_rows > 5:
                await asyncio.sleep(0.001)
        gate.opened.set()
        for call, rows in ((held, 2), (calls[0], 3)):
            np.testing.assert_array_equal(await call, engine.model("skin").evaluate(make_windows(rows)))
        counted = unpackb(await source.get("taxel/v2/models/skin/stats"))
        assert (counted["requests"], counted["rows"], counted["errors"]) == (5, 5, {})
        assert counted["cancelled"] == {"requests": 3, "rows": 9}

    async def connected(server: Service | MemoryServer) -> None:
        if isinstance(server, MemoryServer):
            source = taxel.connect_async(transport=server)
        elif transport == "replicas":
            source = taxel.connect_async([endpoint, "tcp/127.0.0.1:1"])
        else:
            source = taxel.connect_async(endpoint, transport=transport)
        async with source:
            await main(source, server)

    if transport == "memory":
        with MemoryServer(engine) as memory:
            asyncio.run(connected(memory))
    else:
        service = Service(engine, ServerOptions(listen=(endpoint,))).start()
        asyncio.run(connected(service))
        assert service.close()


def test_a_client_that_turns_to_another_server_gives_up_at_the_silent_one(
    gated: tuple[Engine, Gate],
    engine: Engine,
    endpoint: str,
    start: ServerStarter,
    make_windows: WindowMaker,
) -> None:
    stuck, gate = gated
    silent = Service(stuck, ServerOptions(listen=(endpoint,))).start()
    places = [start(engine), endpoint]
    gate.shut()
    with taxel.connect(places[1], transport="zenoh") as holding, ThreadPoolExecutor(1) as pool:
        held = pool.submit(holding.predictor("skin").predict, make_windows(2))
        assert gate.entered.wait(10)
        with taxel.connect(places) as source:
            predictor = source.predictor("skin")
            while not source.retries:
                predictor.predict(make_windows(3))
            ends = time.monotonic() + 10
            while silent.queued_rows > 2:
                assert time.monotonic() < ends
                time.sleep(0.001)
            assert silent.is_live
        gate.opened.set()
        assert held.result().shape == (2, 21)
        counted = unpackb(holding.get("taxel/v2/models/skin/stats"))
        assert counted["cancelled"]["requests"] >= 1
    assert silent.close()


def test_an_older_server_is_not_told(
    gated: tuple[Engine, Gate], endpoint: str, make_windows: WindowMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would close the lane at a frame that it does not know, and log a key that it does not have."""
    engine, gate = gated
    monkeypatch.setattr(lane_transport, "EXTENSIONS", ())
    monkeypatch.setattr(metadata, "MODEL_EXTENSIONS", ())
    gate.shut()
    service = Service(engine, ServerOptions(listen=(endpoint,))).start()

    async def main(transport: Transport) -> None:
        async with taxel.connect_async(endpoint, transport=transport) as source:
            predictor = await source.predictor("skin")
            call = asyncio.create_task(predictor.predict(make_windows(2)))
            while not service.queued_rows:
                await asyncio.sleep(0.001)
            call.cancel()
            await asyncio.gather(call, return_exceptions=True)
            gate.opened.set()
            assert (await predictor.predict(make_windows(3))).shape == (3, 21)
            assert source.retries == 0
            gate.shut()

    for transport in ("lane", "zenoh"):
        asyncio.run(main(transport))
    gate.opened.set()
    with taxel.connect(endpoint, transport="zenoh") as source:
        told = unpackb(source.get("taxel/v2/stats"))
    (counted,) = [each for each in told["models"] if (each["name"], each["version"]) == ("skin", "10")]
    assert (counted["cancelled"]["requests"], counted["rows"], told["refusals"]) == (0, 10, [])
    assert service.close()

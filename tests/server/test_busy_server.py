"""A server that computes: still answers, refuses, keeps deadlines, and stops without losing a query."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from numpy.typing import NDArray

import taxel
from taxel.errors import DeadlineExceeded, ResourceExhausted, Unavailable
from taxel.protocol import unpackb
from taxel.remote import Transport
from taxel_server import engine as engine_module
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.runtimes import EvaluatorInfo, Runtime
from taxel_server.service import Service

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]


class Gate:
    """A real runtime that waits to be let through."""

    def __init__(self, runtime: Runtime) -> None:
        self.runtime = runtime
        self.features, self.parameters = runtime.features, runtime.parameters
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
    place = start(engine, max_queue_rows=12, max_request_rows=8)
    gate.shut()
    with taxel.connect(place, transport=transport) as client, ThreadPoolExecutor(1) as pool:
        predictor = client.predictor("skin")
        running = pool.submit(predictor.predict, make_windows(4))
        assert gate.entered.wait(10)
        with pytest.raises(DeadlineExceeded):
            predictor.predict(make_windows(3), timeout=0.01)
        with pytest.raises(ResourceExhausted, match="the queue is full: 7 of 12 rows"):
            predictor.predict(make_windows(6))
        assert client.ready()
        assert len(client.models()) == 3
        gate.opened.set()
        np.testing.assert_array_equal(running.result(), engine.model("skin").evaluate(make_windows(4)))
        assert predictor.predict(make_windows(8)).shape == (8, 21)
        errors = unpackb(client.get("taxel/v2/models/skin/stats"))["errors"]
    assert errors == {"RESOURCE_EXHAUSTED": 1, "DEADLINE_EXCEEDED": 1}


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

"""The trace context of the W3C: carried, told by the log, and the parent of the server's spans."""

import asyncio
import json
import logging
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from opentelemetry import trace
from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

import taxel
from taxel.errors import InvalidArgument
from taxel_server.engine import Engine
from taxel_server.transports import lane_connection, lane_transport
from taxel_server.transports.memory import MemoryServer

WindowMaker = Callable[..., NDArray[np.float32]]
TRACE_ID = 0x4BF92F3577B34DA6A3CE929D0E0E4736
TRACEPARENT = f"00-{TRACE_ID:032x}-00f067aa0ba902b7-01"


@pytest.fixture(scope="module")
def provider() -> TracerProvider:
    """A process has one."""
    made = TracerProvider()
    trace.set_tracer_provider(made)
    return made


@pytest.fixture
def exporter(provider: TracerProvider) -> Iterator[InMemorySpanExporter]:
    exporter = InMemorySpanExporter()
    processor = SimpleSpanProcessor(exporter)
    provider.add_span_processor(processor)
    yield exporter
    processor.shutdown()


def spans(exporter: InMemorySpanExporter, count: int) -> list[ReadableSpan]:
    """So many spans, which are made just after their answer was given."""
    ends = time.monotonic() + 10
    while len(made := exporter.get_finished_spans()) < count:
        assert time.monotonic() < ends
        time.sleep(0.001)
    assert len(made) == count
    return list(made)


@pytest.fixture(params=["lane", "zenoh", "memory"])
def source(
    request: pytest.FixtureRequest, engine: Engine, start: Callable[..., str]
) -> Iterator[taxel.remote.RemoteSource]:
    if request.param == "memory":
        with MemoryServer(engine) as server, taxel.connect(transport=server) as source:
            yield source
    else:
        with taxel.connect(start(engine), transport=request.param) as source:
            yield source


def test_a_request_has_spans_below_the_clients(
    source: Any, exporter: InMemorySpanExporter, provider: TracerProvider, make_windows: WindowMaker
) -> None:
    predictor = source.predictor("skin")
    windows = make_windows(3)
    expected = predictor.predict(windows)
    assert not exporter.get_finished_spans(), "nobody asked for spans"
    with provider.get_tracer("test").start_as_current_span("step") as step:
        carrier: dict[str, str] = {}
        TraceContextTextMapPropagator().inject(carrier)
        np.testing.assert_array_equal(predictor.predict(windows, **carrier), expected)
        *made, whole = spans(exporter, 3)
    by_name = {span.name: span for span in made}
    assert (whole.name, by_name.keys()) == ("infer skin", {"queue", "compute"})
    assert whole.context is not None
    assert whole.context.trace_id == step.get_span_context().trace_id
    assert whole.parent is not None
    assert whole.parent.span_id == step.get_span_context().span_id
    queue, compute = by_name["queue"], by_name["compute"]
    for span in (queue, compute):
        assert span.parent is not None
        assert span.parent.span_id == whole.context.span_id
    assert (queue.start_time, queue.end_time, compute.end_time) == (
        whole.start_time,
        compute.start_time,
        whole.end_time,
    )
    assert dict(whole.attributes or {})["taxel.model"] == "skin/10"


def test_a_refused_request_is_told_with_its_trace(
    source: Any,
    exporter: InMemorySpanExporter,
    make_windows: WindowMaker,
    caplog: pytest.LogCaptureFixture,
) -> None:
    predictor = source.predictor("skin")
    predictor.checked = lambda windows: windows
    wrong = make_windows(2)
    wrong[1, 1] = np.nan
    with caplog.at_level(logging.WARNING), pytest.raises(InvalidArgument, match="is nan"):
        predictor.infer(wrong, traceparent=TRACEPARENT)
    _, whole = spans(exporter, 2)
    assert whole.context is not None
    assert whole.context.trace_id == TRACE_ID
    assert dict(whole.attributes or {})["taxel.code"] == "INVALID_ARGUMENT"
    (record,) = [record for record in caplog.records if record.name == "taxel_server.refusals"]
    assert record.__dict__["fields"]["trace_id"] == f"{TRACE_ID:032x}"


@pytest.mark.parametrize("transport", ["lane", "zenoh"])
def test_an_awaited_call_carries_it_too(
    engine: Engine,
    start: Callable[..., str],
    exporter: InMemorySpanExporter,
    make_windows: WindowMaker,
    transport: Any,
) -> None:
    windows = make_windows(70)

    async def main() -> NDArray[np.float32]:
        async with taxel.connect_async(start(engine), transport=transport) as source:
            predictor = await source.predictor("skin")
            with pytest.raises(InvalidArgument, match="expected a W3C traceparent"):
                await predictor.predict(windows, traceparent="mine")
            return await predictor.predict(windows, traceparent=TRACEPARENT)

    np.testing.assert_array_equal(asyncio.run(main()), engine.model("skin").evaluate(windows))
    assert {span.context.trace_id for span in spans(exporter, 3) if span.context} == {TRACE_ID}


def test_an_older_server_is_not_sent_one_over_the_lane(
    engine: Engine,
    start: Callable[..., str],
    exporter: InMemorySpanExporter,
    make_windows: WindowMaker,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(lane_transport, "EXTENSIONS", lane_connection.EXTENSIONS[:1])
    with taxel.connect(start(engine), transport="lane") as source:
        predictor = source.predictor("skin")
        predictor.predict(make_windows(2), traceparent=TRACEPARENT)
        assert source.retries == 0
    assert not exporter.get_finished_spans()


def test_the_launcher_of_opentelemetry_prints_the_spans(
    repository: Path, endpoint: str, make_windows: WindowMaker
) -> None:
    """`opentelemetry-instrument taxel serve`, in a process of its own."""
    launcher, taxel_program = (
        Path(sys.executable).parent / n for n in ("opentelemetry-instrument", "taxel")
    )
    exporters = ["--traces_exporter", "console", "--metrics_exporter", "none", "--logs_exporter", "none"]
    serve = ["serve", "--repository", str(repository), "--listen", endpoint, "--json"]
    command = [str(launcher), *exporters, str(taxel_program), *serve]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        assert json.loads(server.stdout.readline())["listen"] == [endpoint]
        with taxel.connect(endpoint) as source:
            source.predictor("skin").predict(make_windows(3), traceparent=TRACEPARENT)
    finally:
        server.terminate()
        # After its first line, what a server prints goes to stderr.
        _, printed = server.communicate(timeout=60)
    whole, decoder = [], json.JSONDecoder()
    while printed := printed.lstrip():
        span, end = decoder.raw_decode(printed)
        whole, printed = [*whole, span], printed[end:]
    assert {span["name"] for span in whole} == {"queue", "compute", "infer skin"}
    assert {span["context"]["trace_id"] for span in whole} == {f"0x{TRACE_ID:032x}"}

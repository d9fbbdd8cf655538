"""The memory transport: a server in this process answers as one behind a socket does."""

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import taxel
from taxel.errors import (
    DeadlineExceeded,
    InvalidArgument,
    NotFound,
    RequestError,
    ResourceExhausted,
    Unavailable,
)
from taxel.protocol import pack_infer_request, unpackb
from taxel.remote import RemoteSource
from taxel_server.engine import Engine, LoadedModel
from taxel_server.options import ServerOptions
from taxel_server.transports.memory import MemoryServer

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]


def outcome(call: Callable[[], Any]) -> Any:
    """A result in a form that can be compared; of an error, its class and text."""
    try:
        result = call()
    except RequestError as error:
        return type(error), str(error)
    return result.tolist() if isinstance(result, np.ndarray) else result


def test_it_answers_as_a_server_behind_zenoh_does(
    engine: Engine, memory: RemoteSource, start: ServerStarter, make_windows: WindowMaker
) -> None:
    with taxel.connect(start(engine), transport="zenoh") as zenoh:
        sources = (memory, zenoh)
        assert memory.models() == zenoh.models()
        assert [source.ready() for source in sources] == [True, True]
        for name, version in (("skin", None), ("skin", "2"), ("skin", "3"), ("skn", None)):
            first, second = (
                outcome(lambda s=s, n=name, v=version: s.predictor(n, v).manifest) for s in sources
            )
            assert first == second
        near, far = (source.predictor("skin") for source in sources)
        for rows in (1, 7, 3000):
            windows = make_windows(rows, seed=rows)
            assert outcome(lambda w=windows: near.predict(w)) == outcome(lambda w=windows: far.predict(w))
        nan = pack_infer_request(np.full((1, 6), np.nan, np.float32))
        wide = pack_infer_request(make_windows(2, 12))
        for path, payload in (
            ("v2/models/skin/infer", b"\xc1"),
            ("v2/models/skin/infer", nan),
            ("v2/models/skin/infer", wide),
            ("v2/models/skin/infer", None),
            ("v2/models/skn/infer", wide),
            ("v3", None),
        ):
            key = f"taxel/{path}"
            first, second = (outcome(lambda s=s, k=key, p=payload: s.get(k, p)) for s in sources)
            assert first == second
            assert issubclass(first[0], (InvalidArgument, NotFound))
    with pytest.raises(Unavailable, match="nobody answers other/v2"):
        memory.get("other/v2")


def test_timing_tells_of_the_server(memory: RemoteSource, make_windows: WindowMaker) -> None:
    predictor = memory.predictor("skin")
    windows = make_windows(5)
    before = unpackb(memory.get("taxel/v2/models/skin/stats"))
    channels, timing = predictor.predict(windows, timing=True)
    after = unpackb(memory.get("taxel/v2/models/skin/stats"))
    np.testing.assert_array_equal(channels, predictor.predict(windows))
    assert timing.batch_rows == 5
    for name, told in (("queue_us", timing.queue_us), ("compute_us", timing.compute_us)):
        assert after[name]["sum"] - before[name]["sum"] == told
    assert predictor.transport == "memory"


@pytest.fixture
def slow(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each evaluation takes a tenth of a second longer."""
    evaluate = LoadedModel.evaluate

    def slowly(self: LoadedModel, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        time.sleep(0.1)
        return evaluate(self, windows)

    monkeypatch.setattr(LoadedModel, "evaluate", slowly)


@pytest.mark.usefixtures("slow")
def test_admission_and_deadlines_are_the_servers(engine: Engine, make_windows: WindowMaker) -> None:
    options = ServerOptions(max_queue_rows=8, max_request_rows=4, max_batch_rows=1)
    with (
        MemoryServer(engine, options) as server,
        taxel.connect(transport=server) as first,
        taxel.connect(transport=server) as second,
        ThreadPoolExecutor(1) as pool,
    ):
        busy = pool.submit(first.predictor("skin").predict, make_windows(4))
        predictor = second.predictor("skin")
        while not server.queued_rows:
            pass
        with pytest.raises(ResourceExhausted, match="the queue is full"):
            predictor.predict(make_windows(1))
        with pytest.raises(ResourceExhausted, match="expected at most 4"):
            predictor.predict(make_windows(3000))
        assert busy.result().shape == (4, 21)
        with pytest.raises(DeadlineExceeded):
            predictor.predict(make_windows(4), timeout=0.05)

        async def asynchronous() -> None:
            async with taxel.connect_async(transport=server) as source:
                awaited = await source.predictor("skin")
                first = asyncio.create_task(awaited.predict(make_windows(1)))
                while not server.queued_rows:
                    await asyncio.sleep(0)
                with pytest.raises(DeadlineExceeded):
                    await awaited.predict(make_windows(1), timeout=0.01)
                assert (await first).shape == (1, 21)

        # What was too late is still evaluated.
        while server.queued_rows:
            pass
        asyncio.run(asynchronous())


def test_a_source_leaves_its_transport_open_and_a_closed_one_is_unavailable(
    repository: Path, make_windows: WindowMaker
) -> None:
    server = MemoryServer(repository)
    with taxel.connect(transport=server) as source, pytest.raises(Unavailable, match="nobody answers"):
        source.models()
    with server:
        for _ in range(2):
            with taxel.connect(transport=server) as source:
                predictor = source.predictor("skin")
                assert predictor.predict(make_windows(1)).shape == (1, 21)
            with pytest.raises(Unavailable, match="this source was closed"):
                predictor.predict(make_windows(1))
        source = taxel.connect(transport=server)
        predictor = source.predictor("skin")
    with pytest.raises(Unavailable):
        predictor.predict(make_windows(1))
    with pytest.raises(InvalidArgument, match="expected none, as a transport is given"):
        taxel.connect("tcp/127.0.0.1:7447", transport=server)

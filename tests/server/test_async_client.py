"""The asynchronous face: the same answers, many in flight, cancelled calls, losses."""

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import taxel
from taxel.errors import DeadlineExceeded, InvalidArgument, Unavailable
from taxel.lane.async_client import AsyncLane
from taxel.lane.connection import ConnectionLost
from taxel.lane.frames import pack_reply
from taxel.lane.prompt_future import PromptFuture
from taxel.lane.repeated_request import RepeatedRequest
from taxel.protocol import InferResponse
from taxel.remote.async_source import AsyncSource
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.service import Service
from taxel_server.transports.memory import MemoryServer

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]
PATH = "v2/models/skin/infer"


@pytest.fixture(params=["zenoh", "lane", "memory"])
def connect(
    request: pytest.FixtureRequest, memory_server: MemoryServer, engine: Engine, start_module: ServerStarter
) -> Callable[[], AsyncSource]:
    if request.param == "memory":
        return lambda: taxel.connect_async(transport=memory_server)
    place = start_module(engine)
    return lambda: taxel.connect_async(place, transport=request.param)


def test_many_calls_in_flight_get_their_own_answers(
    connect: Callable[[], AsyncSource], engine: Engine, make_windows: WindowMaker
) -> None:
    evaluate = engine.model("skin").evaluate

    async def main() -> None:
        async with connect() as source:
            assert await source.ready()
            assert [model.name for model in await source.models()] == ["skin", "skin", "wide"]
            predictor = await source.predictor("skin")
            assert predictor.transport in ("zenoh", "lane", "memory")
            sizes = [1, 3, 700, 20_000] + [1 + number % 9 for number in range(200)]
            given = [make_windows(rows, seed=number) for number, rows in enumerate(sizes)]
            answers = await asyncio.gather(*map(predictor.predict, given))
            for windows, channels in zip(given, answers, strict=True):
                np.testing.assert_array_equal(channels, evaluate(windows))
            channels, timing = await predictor.predict(given[1], timing=True)
            assert (channels.shape, timing.batch_rows >= 3) == ((3, 21), True)
            with pytest.raises(taxel.NotFound):
                await source.predictor("skn")
            with pytest.raises(InvalidArgument, match="gives no spread"):
                await predictor.predict_with_spread(given[1])
        with pytest.raises(Unavailable, match="closed"):
            await predictor.predict(given[1])

    asyncio.run(main())


def test_a_cancelled_call_leaves_nothing_behind(
    connect: Callable[[], AsyncSource], engine: Engine, make_windows: WindowMaker
) -> None:
    evaluate = engine.model("skin").evaluate

    async def main() -> None:
        async with connect() as source:
            predictor = await source.predictor("skin")
            lanes = source.core.lanes
            lane = lanes.lane if lanes else None
            before = asyncio.all_tasks()
            for number in range(30):
                large = asyncio.create_task(predictor.predict(make_windows(9000, seed=number)))
                small = asyncio.create_task(predictor.predict(make_windows(1, seed=number)))
                await asyncio.sleep(number / 10_000)
                large.cancel()
                small.cancel()
                await asyncio.gather(large, small, return_exceptions=True)
                windows = make_windows(2, seed=number)
                np.testing.assert_array_equal(await predictor.predict(windows), evaluate(windows))
            assert asyncio.all_tasks() == before
            if lane is not None:
                assert lanes is not None
                assert lanes.lane is lane
                assert lane.calls_in_flight == 0

    asyncio.run(main())


def test_a_restarted_server_is_asked_again(
    engine: Engine, endpoint: str, make_windows: WindowMaker
) -> None:
    windows = make_windows(3)

    async def main(transport: Any) -> None:
        service = Service(engine, ServerOptions(listen=(endpoint,))).start()
        async with taxel.connect_async(endpoint, transport=transport, timeout=20) as source:
            predictor = await source.predictor("skin")
            before = await predictor.predict(windows)
            await asyncio.to_thread(service.close)
            with pytest.raises(Unavailable):
                await predictor.predict(windows, timeout=0.05)
            waiting = asyncio.create_task(
                asyncio.to_thread(Service(engine, ServerOptions(listen=(endpoint,))).start)
            )
            while True:
                try:
                    after = await predictor.predict(windows)
                    break
                except Unavailable:
                    await asyncio.sleep(0.01)
            np.testing.assert_array_equal(after, before)
            await asyncio.to_thread((await waiting).close)

    for transport in ("zenoh", "lane"):
        asyncio.run(main(transport))


def test_a_source_belongs_to_one_loop(memory_server: MemoryServer, make_windows: WindowMaker) -> None:
    async def opened() -> Any:
        source = await taxel.connect_async(transport=memory_server)
        return source, await source.predictor("skin")

    source, predictor = asyncio.run(opened())

    async def elsewhere() -> None:
        for call in (source.models, lambda: predictor.predict(make_windows(1))):
            with pytest.raises(Unavailable, match="connect in each loop"):
                await call()

    asyncio.run(elsewhere())
    unopened = taxel.connect_async(transport=memory_server)
    with pytest.raises(Unavailable, match="this source is not open"):
        asyncio.run(unopened.models())


@asynccontextmanager
async def lane_to(folder: Path, *replies: bytes, end: bool = False) -> AsyncIterator[AsyncLane]:
    """A lane to a server that sends some bytes after the first request, and then nothing or its end."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(10_000)
        writer.writelines(replies)
        if end:
            writer.close()
        await reader.read()
        writer.close()
        gone.set()

    gone = asyncio.Event()
    server = await asyncio.start_unix_server(serve, folder / "lane")
    lane = await AsyncLane.open(f"unix:{folder / 'lane'}")
    try:
        yield lane
    finally:
        lane.close()
        await gone.wait()
        server.close()
        (folder / "lane").unlink()


@pytest.mark.parametrize("reply", [b"", b"TXL1", b"TXL1\x20\0\0\0"])
def test_a_silent_lane_exceeds_each_calls_own_deadline(tmp_path: Path, reply: bytes) -> None:
    async def main() -> None:
        async with lane_to(tmp_path, reply) as lane:
            windows = np.zeros((1, 6), np.float32)
            waits = [0.15, 0.1, 0.05]
            calls = [lane.infer(PATH, windows, wait, wait, spread=False) for wait in waits]
            outcomes = await asyncio.gather(*calls, return_exceptions=True)
            for wait, outcome in zip(waits, outcomes, strict=True):
                assert isinstance(outcome, DeadlineExceeded)
                assert f"no answer within {wait:g} s" in str(outcome)
            assert lane.calls_in_flight == 0

    asyncio.run(main())


def test_a_lane_that_ends_or_talks_nonsense_is_lost(tmp_path: Path) -> None:
    two = InferResponse(np.zeros((2, 21), np.float32), "skin", "1", None, 0, 0, 2)

    async def main() -> None:
        for replies in ([], [b"HTTP/1.1 400 Bad Request\r\n\r\n" * 2], [pack_reply(1, two)]):
            async with lane_to(tmp_path, *replies, end=not replies) as lane:
                for _ in range(2):
                    with pytest.raises(ConnectionLost):
                        await lane.infer(PATH, np.zeros((1, 6), np.float32), 9, 9, spread=False)

    asyncio.run(main())


@settings(max_examples=60)
@given(
    sizes=st.lists(st.sampled_from([1, 2, 9, 750, 1500]), min_size=1, max_size=6),
    abandoned=st.sets(st.integers(0, 5)),
    seed=st.integers(0, 999),
    cuts=st.lists(st.floats(0, 1), max_size=12),
)
def test_replies_in_any_order_and_in_any_pieces_find_their_calls(
    sizes: list[int], abandoned: set[int], seed: int, cuts: list[float]
) -> None:
    async def main() -> None:
        lane = AsyncLane("unix:/x", (), ends[0])
        calls = [
            asyncio.create_task(lane.infer(PATH, np.zeros((rows, 6), np.float32), 9, 9, spread=False))
            for rows in sizes
        ]
        await asyncio.sleep(0)
        replies = [
            pack_reply(
                number,
                InferResponse(np.full((rows, 21), number, np.float32), "skin", "1", None, 1, 2, rows),
            )
            for number, rows in enumerate(sizes, start=1)
        ]
        for number in abandoned & set(range(len(sizes))):
            calls[number].cancel()
        await asyncio.sleep(0)
        Random(seed).shuffle(replies)
        stream = b"".join(replies)
        at = 0
        for stop in sorted([*(round(cut * len(stream)) for cut in cuts), len(stream)]):
            while at < stop:
                with suppress(BlockingIOError):
                    at += ends[1].send(stream[at:stop])
                await asyncio.sleep(0)
        for number, (rows, call) in enumerate(zip(sizes, calls, strict=True)):
            if number in abandoned:
                assert call.cancelled()
            else:
                head, (counts,) = await call
                assert (head.rows, counts.shape) == (rows, (rows, 21))
                assert (counts == number + 1).all()
        assert lane.calls_in_flight == 0
        lane.close()
        await asyncio.sleep(0)

    ends = socket.socketpair()
    for end in ends:
        end.setblocking(False)
    with ends[1]:
        asyncio.run(main())


def test_a_reply_that_is_there_is_taken_without_a_turn_of_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    # However slow the machine is, a reply counts as quick.
    monkeypatch.setattr("taxel.lane.async_client._QUICK_S", 60.0)
    monkeypatch.setattr("taxel.polling.MOST_A_TURN_S", 60.0)
    windows = np.zeros((1, 6), np.float32)
    request = RepeatedRequest(PATH, (1, 6), 9, 9)
    reply = InferResponse(np.ones((1, 21), np.float32), "skin", "1", None, 1, 2, 1)
    late = InferResponse(np.zeros((1, 21), np.float32), "skin", "1", None, 1, 2, 1)

    async def main() -> None:
        lane = AsyncLane("unix:/x", (), ends[0])
        loop, at_once = asyncio.get_running_loop(), 0
        for number in range(1, 2001):
            if number % 3 == 0:
                # Of a call that was given up; it may come in one piece with the other.
                ends[1].send(pack_reply(number + 10_000, late))
            ends[1].send(pack_reply(number, reply))
            turned: list[bool] = []
            loop.call_soon(turned.append, True)
            assert (await lane.repeat(request, windows) == 1).all()
            at_once += not turned
            ends[1].recv(1 << 16)
            if number % 50 == 0:
                await asyncio.sleep(0)
        assert at_once > 100
        assert lane.calls_in_flight == 0
        lane.close()

    ends = socket.socketpair()
    ends[0].setblocking(False)
    with ends[0], ends[1]:
        asyncio.run(main())


def test_a_task_that_asks_without_end_lets_others_run_and_is_cancelled(
    engine: Engine, start_module: ServerStarter, make_windows: WindowMaker
) -> None:
    async def main() -> None:
        async with taxel.connect_async(start_module(engine), transport="lane") as source:
            predictor = await source.predictor("skin")
            windows = make_windows(1)
            asked = turns = 0

            async def ask() -> None:
                nonlocal asked
                while True:
                    await predictor.predict(windows)
                    asked += 1

            task = asyncio.create_task(ask())
            while asked < 2000:
                await asyncio.sleep(0)
                turns += 1
            assert turns > 20
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    asyncio.run(main())


def test_a_future_goes_on_with_its_task_at_once_where_none_runs() -> None:
    order: list[object] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()

        async def waits(future: PromptFuture[str]) -> None:
            order.append(await future)

        def callback(future: PromptFuture[str]) -> None:
            future.settle("at once")
            future.settle("again")
            order.append("after the callback")

        prompt, later, cancelled = (PromptFuture[str](loop=loop) for _ in range(3))
        tasks = [asyncio.create_task(waits(future)) for future in (prompt, later, cancelled)]
        await asyncio.sleep(0)
        loop.call_soon(callback, prompt)
        await tasks[0]
        later.settle("in its turn")
        order.append("after this task's step")
        await tasks[1]
        tasks[2].cancel()
        cancelled.settle("too late")
        with pytest.raises(asyncio.CancelledError):
            await tasks[2]
        done = PromptFuture[str](loop=loop)
        done.settle("nobody waited yet")
        assert await done == "nobody waited yet"

    asyncio.run(main())
    assert order == ["at once", "after the callback", "after this task's step", "in its turn"]


def test_a_control_loop_may_close_stop_waiting_and_go_on(
    connect: Callable[[], AsyncSource], engine: Engine, make_windows: WindowMaker
) -> None:
    """Its calls are repeated ones, whose tasks go on inside of the loop's callbacks."""
    evaluate = engine.model("skin").evaluate

    async def main() -> None:
        source = await connect()
        predictor = await source.predictor("skin")
        for number in range(60):
            windows = make_windows(1 + number % 3, seed=number)
            np.testing.assert_array_equal(await predictor.predict(windows), evaluate(windows))
        windows = make_windows(2)
        windows[0, 0] = np.nan
        with pytest.raises(InvalidArgument, match="is nan"):
            await predictor.predict(windows)
        both = await asyncio.gather(*(predictor.predict(make_windows(2, seed=seed)) for seed in (1, 2)))
        np.testing.assert_array_equal(both, [evaluate(make_windows(2, seed=seed)) for seed in (1, 2)])
        with suppress(TimeoutError):
            async with asyncio.timeout(0):
                await predictor.predict(make_windows(2))
        await predictor.predict(make_windows(2))
        await source.close()
        with pytest.raises(Unavailable, match="closed"):
            await predictor.predict(make_windows(2))

    asyncio.run(main())

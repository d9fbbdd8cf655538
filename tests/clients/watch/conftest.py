"""Small recordings with known counts, and the page served in this process."""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from threading import Event, Thread

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel_models.recordings import Recording
from taxel_watch.page_server import page_server
from taxel_watch.replay import Predictions, Replay
from taxel_watch.scene import CORRECTED, PREDICTED, Source

ROWS = 600


class Clock:
    """Time that passes only when it is told to."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def pressed(number: int = 0) -> Recording:
    """Six seconds: untouched for one, then pressed ever harder; each electrode changes in its own way."""
    time = np.arange(ROWS)
    press = np.maximum(0.0, (time - 100) / 200)
    force = np.column_stack([0.1 * press, 0.2 * press, press])
    position = np.tile([-0.006, 0.0015, -0.0068], (ROWS, 1))
    gains = np.concatenate([[30.0, 120.0], np.linspace(-400.0, 150.0, 19)]) * (1 - 0.5 * number)
    rest = 2000.0 + 10 * np.arange(len(CHANNELS))
    return Recording.of(
        10_000_000 * time,
        position,
        force,
        rest + press[:, None] * gains,
        {name: np.zeros(ROWS) for name in ("pac1", "tac", "tdc")},
        name=f"pressed-{number}",
    )


def replay_of_two(clock: Callable[[], float] | None = None, *, predicted: bool = True) -> Replay:
    """Two fingertips, with predictions that are wrong by a known number of counts."""
    recordings = [pressed(0), pressed(1)]
    replay = Replay(
        recordings,
        kind="recording",
        title="two.csv",
        names=[("left", "thumb"), ("left", "index")],
        **({} if clock is None else {"clock": clock}),
    )
    if predicted:
        counts = []
        for recording in recordings:
            wrong = recording.channels - 60.0
            wrong[:10] = np.nan
            counts.append({PREDICTED: wrong, CORRECTED: recording.channels - 8.0})
        replay.predicted(
            Predictions(
                {PREDICTED: "xgb/1", CORRECTED: "xgb/2"}, counts, "", {"p50": 50.0, "p99": 90.0}, "here"
            )
        )
    return replay


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def paced(clock: Clock) -> Replay:
    """Two fingertips that play when the clock is told to go on."""
    return replay_of_two(clock)


@pytest.fixture
def measured_only(clock: Clock) -> Replay:
    """The same without predictions."""
    return replay_of_two(clock, predicted=False)


@contextmanager
def served(source: Source) -> Iterator[str]:
    """The address of a source's page, served by a thread."""
    ready, stop_it = Event(), []
    address: list[str] = []

    async def serve() -> None:
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        stop_it.append(lambda: loop.call_soon_threadsafe(stop.set))
        async with page_server(source, "127.0.0.1", 0) as place:
            address.append(place)
            ready.set()
            await stop.wait()

    thread = Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    assert ready.wait(30)
    try:
        yield address[0]
    finally:
        stop_it[0]()
        thread.join()


@pytest.fixture
def serve() -> Iterator[Callable[[Source], str]]:
    """Serves sources until the test ends."""
    with ExitStack() as stack:
        yield lambda source: stack.enter_context(served(source))

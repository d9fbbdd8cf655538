"""Loads a version again and again beside a control loop of another process."""

import multiprocessing
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from typing import Final

import numpy as np
import psutil
from numpy.typing import NDArray

import taxel
from taxel.administration import Order, give_order
from taxel.commands.check import run_loop
from taxel.errors import Unavailable
from taxel.remote.options import Transport
from taxel_bench.server_process import RunningServer

_CHUNK_S: Final = 0.5
_SHARES: Final = {"p50": 0.5, "p90": 0.9, "p99": 0.99, "p99_9": 0.999, "max": 1.0}
_LOAD_TIMEOUT_S: Final = 600.0
_SETTLED_S: Final = 3.0

_EARLY: Final = 10
"""After so many loads, memory is expected to stay."""

_MORE: Final = {"memory_mib": 32.0, "threads": 3.0, "files": 0.0}
"""By how much a server may grow after that and count as flat.

Its second loading thread may start only then, and zenoh's threads come and go.
"""


@dataclass(frozen=True)
class Loop:
    """What a loop saw in a while; times in ms.

    Attributes:
        steps: that were due.
        late: without an answer before the next step was due.
        failed: that got an error.
        round_trip_ms: percentiles.
        timer_ms: how late the machine woke the loop, percentiles.
    """

    steps: int
    late: int
    failed: int
    round_trip_ms: dict[str, float]
    timer_ms: dict[str, float]


@dataclass(frozen=True)
class Reloads:
    """What was measured.

    Attributes:
        calm: the loop while nothing was loaded.
        loading: the loop while versions were loaded.
        load_s: seconds of each load.
        memory_mib: of the server, before the first load and after each.
        threads: of the server, likewise.
        files: that it has open, likewise.
    """

    calm: Loop
    loading: Loop
    load_s: list[float]
    memory_mib: list[float]
    threads: list[int]
    files: list[int]


def load_again(
    server: RunningServer,
    model: str,
    transport: Transport,
    loads: int,
    rate: float,
    calm_s: float,
    tell: Callable[[int], None],
) -> Reloads:
    """Measure a loop in calm, and while a version is loaded again and again.

    Args:
        server: of this machine.
        model: that the loop asks and that is loaded.
        transport: of the loop.
        loads: how often.
        rate: steps of the loop in a second.
        calm_s: seconds of calm.
        tell: told how many loads are done.

    Raises:
        RequestError: a version was refused, or the loop could not ask.
    """
    process = psutil.Process(server.pid)
    with taxel.connect(server.endpoint, transport="zenoh") as source:
        version = source.predictor(model).manifest.version
        calm = _beside(server, model, transport, rate, lambda: time.sleep(calm_s))
        load_s, held = list[float](), [_held(process)]

        def load() -> None:
            for done in range(loads):
                started = time.monotonic()
                give_order(source, Order("load", model, version), _LOAD_TIMEOUT_S)
                load_s.append(time.monotonic() - started)
                held.append(_held(process))
                tell(done + 1)

        loading = _beside(server, model, transport, rate, load)
        time.sleep(_SETTLED_S)
        held[-1] = _held(process)
    memory, threads, files = zip(*held, strict=True)
    return Reloads(calm, loading, load_s, list(memory), list(threads), list(files))


def reasons_against(measured: Reloads) -> list[str]:
    """Why the server does not count as undisturbed and flat."""
    reasons = []
    if failed := measured.calm.failed + measured.loading.failed:
        reasons.append(f"{failed} requests failed")
    early = min(_EARLY, len(measured.memory_mib) - 1)
    for name, more in _MORE.items():
        told = getattr(measured, name)
        before, after = max(told[: early + 1]), told[-1]
        if after > before + more:
            reasons.append(f"{name} grew from {before:.0f} to {after:.0f}")
    return reasons


def _beside(
    server: RunningServer, model: str, transport: Transport, rate: float, work: Callable[[], None]
) -> Loop:
    """What a loop sees while `work` is done here."""
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    ours, theirs = context.Pipe()
    loop = context.Process(
        target=_ask_on, args=(server.endpoint, model, transport, rate, stop, theirs), daemon=True
    )
    loop.start()
    theirs.close()
    try:
        if ours.recv() != "ready":
            raise Unavailable("the loop could not ask")
        work()
        stop.set()
        told: Loop = ours.recv()
    except EOFError:
        raise Unavailable("the loop ended early: its error stands above") from None
    finally:
        stop.set()
        loop.join()
    return told


def _ask_on(
    endpoint: str, model: str, transport: Transport, rate: float, stop: Event, told: Connection
) -> None:
    """Be the loop, in a process of its own, until it is told to stop."""
    trips: list[NDArray[np.float64]] = []
    timers: list[NDArray[np.float64]] = []
    steps = late = failed = 0
    with taxel.connect(endpoint, transport=transport) as source:
        predictor = source.predictor(model)
        windows = np.asarray(predictor.manifest.typical_window, np.float32)[np.newaxis]
        count = max(round(rate * _CHUNK_S), 1)
        run_loop(predictor, windows, rate, count)
        told.send("ready")
        while not stop.is_set():
            seen = run_loop(predictor, windows, rate, count)
            trips.append(seen.round_trip)
            timers.append(seen.timer)
            steps, late, failed = steps + count, late + seen.late, failed + seen.failed
    told.send(Loop(steps, late, failed, _percentiles(trips), _percentiles(timers)))


def _percentiles(times_us: list[NDArray[np.float64]]) -> dict[str, float]:
    times = np.concatenate(times_us) / 1e3
    return {name: round(float(np.quantile(times, share)), 3) for name, share in _SHARES.items()}


def _held(process: psutil.Process) -> tuple[float, int, int]:
    with process.oneshot():
        return round(process.memory_info().rss / 2**20, 1), process.num_threads(), process.num_fds()

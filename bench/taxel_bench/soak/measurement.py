"""Lets clients ask a server for minutes, and looks at what it holds meanwhile."""

import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import psutil
from numpy.typing import NDArray

from taxel_bench.chaos.bars import Bar
from taxel_bench.server_process import RunningServer
from taxel_bench.soak.clients import Asked, control_loop, visitors
from taxel_bench.verdict import queries_for

RATE_HZ: Final = 100.0
VISITORS_ROWS: Final = 1024
VISITORS_PAUSE_S: Final = 2.0

POINTS: Final = 60
"""Intervals that a run is cut into, for p99 and for plots."""

SETTLING: Final = 0.1
"""The share of the run in which caches and pools may still fill."""

MORE_MEMORY_MIB: Final = 32.0
"""By how much memory may grow and count as flat, as in `bench churn`."""

MOST_P99_GROWTH: Final = 2.0

_HEAD_START_S: Final = 8.0
"""Client processes need seconds to import what they need."""

_LOOK_S: Final = 1.0


@dataclass(frozen=True)
class Moment:
    """What the server held at one moment, and how busy the machine was.

    Attributes:
        seconds: from the start.
        memory_mib: resident memory.
        files: open files.
        threads: threads.
        load: busy or waiting threads of the machine, mean over the last minute.
    """

    seconds: float
    memory_mib: float
    files: int
    threads: int
    load: float


@dataclass(frozen=True)
class Soak:
    """A run: what the server held, and what its clients got."""

    seconds: float
    moments: list[Moment]
    asked: list[Asked]


def soak_server(server: RunningServer, model: str, seconds: float, tell: Callable[[float], None]) -> Soak:
    """Two control loops at 100 Hz, over the lane and over zenoh, and visitors of both, for so many seconds.

    Args:
        tell: how many seconds have passed.

    Raises:
        RequestError: a client could not connect.
    """
    process = psutil.Process(server.pid)
    context = multiprocessing.get_context("spawn")
    moments: list[Moment] = []
    with ProcessPoolExecutor(4, context) as pool:
        start = time.perf_counter() + _HEAD_START_S
        asking: list[Future[Asked]] = [
            pool.submit(control_loop, server.endpoint, transport, model, RATE_HZ, start, seconds)
            for transport in ("lane", "zenoh")
        ]
        visit = (model, VISITORS_ROWS, VISITORS_PAUSE_S, start, seconds)
        asking += [
            pool.submit(visitors, server.endpoint, transport, *visit) for transport in ("lane", "zenoh")
        ]
        while (passed := time.perf_counter() - start) < seconds:
            # A client that failed would be missed for the whole run.
            for future in asking:
                if future.done():
                    future.result()
            if passed >= 0:
                moments.append(_moment(process, passed))
                tell(passed)
            time.sleep(_LOOK_S)
        return Soak(seconds, moments, [future.result() for future in asking])


def _moment(process: psutil.Process, seconds: float) -> Moment:
    with process.oneshot():
        memory, files, threads = process.memory_info().rss, process.num_fds(), process.num_threads()
    return Moment(seconds, memory / 2**20, files, threads, psutil.getloadavg()[0])


def p99_by_interval(asked: Asked, seconds: float) -> NDArray[np.float64]:
    """p99 of a client's latencies in each interval, (POINTS,), ms; NaN where too few answers came."""
    place = np.minimum((np.asarray(asked.due) / seconds * POINTS).astype(int), POINTS - 1)
    latency = np.asarray(asked.latency_ms)
    p99 = np.full(POINTS, np.nan)
    for interval in range(POINTS):
        own = latency[(place == interval) & np.isfinite(latency)]
        if len(own) >= queries_for(99):
            p99[interval] = np.percentile(own, 99)
    return p99


def bars_of(soak: Soak) -> list[Bar]:
    """What must be true of a run: the end is as the beginning, once the beginning has settled.

    The medians of the last quarter and of the first quarter after settling are compared.
    """
    seconds = np.array([moment.seconds for moment in soak.moments])
    bars = []
    for name, what, more in (
        ("memory_mib", "memory, MiB more", MORE_MEMORY_MIB),
        ("files", "open files more", 0.0),
        ("threads", "threads more", 0.0),
    ):
        held = np.array([getattr(moment, name) for moment in soak.moments], np.float64)
        before, after = _ends(held, seconds / soak.seconds)
        bars.append(Bar(f"{what} than at the beginning", after - before, more))
    middles = (np.arange(POINTS) + 0.5) / POINTS
    for asked in soak.asked:
        before, after = _ends(p99_by_interval(asked, soak.seconds), middles)
        if np.isfinite(before) and np.isfinite(after):
            bars.append(
                Bar(f"{asked.name}: p99, of that at the beginning", after / before, MOST_P99_GROWTH)
            )
    failed = sum(asked.errors.total() for asked in soak.asked)
    bars.append(Bar("requests that failed", float(failed), 0.0))
    return bars


def _ends(values: NDArray[np.float64], place: NDArray[np.float64]) -> tuple[float, float]:
    """Medians of the first quarter after settling, and of the last; `place` is from 0 to 1."""
    known = np.isfinite(values)
    early = values[known & (place >= SETTLING) & (place < SETTLING + 0.25)]
    late = values[known & (place >= 0.75)]
    if not len(early) or not len(late):
        return float("nan"), float("nan")
    return float(np.median(early)), float(np.median(late))


def as_dict(soak: Soak) -> dict[str, Any]:
    """For `--json`: what was held at each interval's end, and each client's figures."""
    return {
        "held": [_rounded(moment) for moment in _thinned(soak.moments)],
        "clients": [_figures(asked, soak.seconds) for asked in soak.asked],
    }


def _thinned(moments: Sequence[Moment]) -> Sequence[Moment]:
    return moments[:: max(len(moments) // (2 * POINTS), 1)]


def _rounded(moment: Moment) -> dict[str, float]:
    return {
        "seconds": round(moment.seconds, 1),
        "memory_mib": round(moment.memory_mib, 1),
        "files": moment.files,
        "threads": moment.threads,
        "load": round(moment.load, 2),
    }


def _figures(asked: Asked, seconds: float) -> dict[str, Any]:
    p99 = p99_by_interval(asked, seconds)
    return {
        "client": asked.name,
        "requests": len(asked.due),
        "errors": dict(asked.errors),
        "p99_ms": [round(float(value), 2) if np.isfinite(value) else None for value in p99],
    }

"""A flood: three times what the server can answer, beside a polite client; then what it still holds."""

import multiprocessing
import time
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from threading import Event, Thread
from typing import Any, Final

import numpy as np
import psutil

from taxel.commands.top import waited_for_core
from taxel.errors import Unavailable
from taxel_bench.chaos.bars import Bar
from taxel_bench.chaos.senders import Sent, be_polite, connect, flood, oversize, saturate, statistics
from taxel_server.core.pacing import MOST_WAITING

_FLOODING: Final = 2
"""Processes that flood."""

TIMES_CAPACITY: Final = 3.0
POLITE_HZ: Final = 100.0

OVERSIZE: Final = 400 * 2**20

_TIMEOUT_S: Final = 5.0
_HEAD_START_S: Final = 1.0
_SETTLE_S: Final = 3.0
_IN_FLIGHT_ROWS: Final = 4096
"""Windows on their way from each process while the capacity is measured, in 4 to 64 requests."""


class Memory:
    """The resident memory of a process, looked at all the while; MiB."""

    def __init__(self, process: psutil.Process) -> None:
        self._process = process
        self.peak = self.now()
        self._stop = Event()
        self._thread = Thread(target=self._look, daemon=True)
        self._thread.start()

    def now(self) -> float:
        """At this moment."""
        return float(self._process.memory_info().rss) / 2**20

    def close(self) -> float:
        """Stop looking; the peak."""
        self._stop.set()
        self._thread.join()
        return self.peak

    def _look(self) -> None:
        with suppress(psutil.NoSuchProcess):
            while not self._stop.wait(0.02):
                self.peak = max(self.peak, self.now())


@contextmanager
def client_processes(endpoint: str) -> Iterator[ProcessPoolExecutor]:
    """The flooders and the polite client, connected, each in a process of its own."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(_FLOODING + 1, context, connect, (endpoint, _TIMEOUT_S)) as pool:
        # A process starts with its first task, and takes no second one while that task runs.
        list(pool.map(time.sleep, [2.0] * (_FLOODING + 1)))
        yield pool


def flood_of(
    pool: ProcessPoolExecutor,
    server: psutil.Process,
    model: str,
    rows: int,
    seconds: float,
    flooder: str,
) -> dict[str, Any]:
    """Measure the capacity for requests of so many windows, flood with them, and wait for calm."""
    began = time.monotonic()
    calm_mib = Memory(server).close()
    in_flight = min(max(_IN_FLIGHT_ROWS // rows, 4), 64)
    start = time.perf_counter() + _HEAD_START_S
    used = _cpu_s(server)
    saturating = [pool.submit(saturate, model, rows, in_flight, start, seconds) for _ in range(_FLOODING)]
    capacity = sum(done.result().answered for done in saturating) / seconds
    capacity_cpu_s = _cpu_s(server) - used
    rate = TIMES_CAPACITY * capacity / _FLOODING
    memory = Memory(server)
    before, asked = pool.submit(statistics).result(), time.perf_counter()
    start = time.perf_counter() + _HEAD_START_S
    used = _cpu_s(server)
    polite: Future[Sent] = pool.submit(be_polite, model, POLITE_HZ, start, seconds)
    flooding = [pool.submit(flood, flooder, model, rows, rate, start, seconds) for _ in range(_FLOODING)]
    floods, courtesy = [done.result() for done in flooding], polite.result()
    flood_cpu_s = _cpu_s(server) - used
    waited = waited_for_core(before, pool.submit(statistics).result(), time.perf_counter() - asked)
    peak_mib = memory.close()
    time.sleep(_SETTLE_S)
    return {
        "flooder": flooder,
        "rows": rows,
        "capacity_per_s": capacity,
        "sent_per_s": sum(each.requests for each in floods) / seconds,
        "answered_per_s": sum(each.answered for each in floods) / seconds,
        "errors": _added(floods),
        "refusal_ms": _percentiles([ms for each in floods for ms in each.refusal_ms]),
        "refusal_after_sending_ms": _percentiles(
            [ms for each in floods for ms in each.refusal_after_sending_ms]
        ),
        "polite": {
            "requests": courtesy.requests,
            "errors": dict(courtesy.errors),
            "latency_ms": _percentiles(courtesy.latency_ms),
        },
        "waited_for_core": waited,
        "server_cpu_s": {"capacity": capacity_cpu_s, "flood": flood_cpu_s},
        "calm_mib": calm_mib,
        "peak_mib": peak_mib,
        "after_mib": Memory(server).close(),
        "monotonic_s": [began, time.monotonic()],
    }


def floods_of(
    pool: ProcessPoolExecutor,
    server: psutil.Process,
    model: str,
    sizes: list[int],
    seconds: float,
    flooders: list[str],
) -> list[dict[str, Any]]:
    """A flood for each size and each kind of flooder.

    Raises:
        Unavailable: the server has ended.
    """
    try:
        return [
            flood_of(pool, server, model, size, seconds, flooder) for size in sizes for flooder in flooders
        ]
    except psutil.NoSuchProcess:
        raise Unavailable(f"the server, process {server.pid}, ended in the flood") from None


def bars_of_floods(
    results: list[dict[str, Any]], refused: list[tuple[float, float]] | None = None
) -> list[Bar]:
    """What must be true of floods; adds to them how long after their arrival requests were refused.

    Args:
        results: of `floods_of`.
        refused: when, on `time.monotonic`, and how many ms after the arrival; None if nobody noted it.
    """
    for result in results if refused is not None else ():
        first, last = result["monotonic_s"]
        result["refusal_after_arrival_ms"] = _percentiles(
            [ms for at, ms in refused or () if first <= at <= last]
        )
    return [bar for result in results for bar in bars_of(result)]


def bars_of(result: dict[str, Any]) -> list[Bar]:
    """What must be true of a flood."""
    what = f"{result['flooder']}, {result['rows']} windows a request"
    # Before it has been sent, a large request cannot have arrived.
    since = "arrival" if "refusal_after_arrival_ms" in result else "sending"
    refusals = result[f"refusal_after_{since}_ms"]
    waited = result["waited_for_core"]
    # Without a core, refusals must not take time from answers: how soon they come is not judged.
    no_core = (
        "" if waited is None or waited <= MOST_WAITING else f"no core: it waited {waited:.0%} of the time"
    )
    return [
        Bar(
            f"{what}: answered, of the capacity",
            result["answered_per_s"] / result["capacity_per_s"],
            0.8,
            at_least=True,
        ),
        Bar(
            f"{what}: refusals, p99 ms from {since}",
            refusals["p99"] if refusals else 0.0,
            5.0,
            excused=no_core,
        ),
        Bar(f"{what}: polite requests that failed", float(sum(result["polite"]["errors"].values())), 0.0),
        Bar(f"{what}: memory afterwards, of calm", result["after_mib"] / result["calm_mib"], 1.1),
    ]


def oversize_of(pool: ProcessPoolExecutor, server: psutil.Process, model: str) -> dict[str, Any]:
    """Send one message that is far too large."""
    calm_mib, memory = Memory(server).close(), Memory(server)
    code, seconds = pool.submit(oversize, model, OVERSIZE).result()
    return {"code": code, "seconds": seconds, "calm_mib": calm_mib, "peak_mib": memory.close()}


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _added(floods: list[Sent]) -> dict[str, int]:
    errors: dict[str, int] = {}
    for each in floods:
        for code, count in each.errors.items():
            errors[code] = errors.get(code, 0) + count
    return errors


def _percentiles(times: list[float]) -> dict[str, float] | None:
    if not times:
        return None
    p50, p99, longest = np.percentile(times, [50, 99, 100])
    return {"p50": float(p50), "p99": float(p99), "max": float(longest)}

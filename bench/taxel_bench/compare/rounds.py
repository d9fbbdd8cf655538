"""Rounds: in each, the servers and the bare runtime have a turn, one after the other."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import Unavailable
from taxel_bench.compare.figures import Figures, Gap
from taxel_bench.compare.servers import ServerUnderTest

AT_ONCE: Final = 64
BULK_ROWS: Final = 1000
BATCH_ROWS: Final = 64

Predict = Callable[[NDArray[np.float32]], NDArray[np.float32]]


@dataclass(frozen=True)
class BareRuntime:
    """The runtime's own call in this process, with nothing around it: medians, ms."""

    one_p50_ms: float
    bulk_p50_ms: float


@dataclass(frozen=True)
class Round:
    """What one round gave.

    Attributes:
        figures: of each server, by its name.
        bare: of the runtime.
    """

    figures: dict[str, Figures]
    bare: BareRuntime


def measure_round(
    number: int,
    servers: Sequence[ServerUnderTest],
    predict: Predict,
    windows: NDArray[np.float32],
    seconds: float,
    gaps_ms: Sequence[float] = (),
) -> Round:
    """One round; whose turn is first changes from round to round.

    Args:
        number: of the round, from 0.
        predict: the bare runtime.
        windows: (m, f), at least `BULK_ROWS`.
        seconds: of each of a server's measurements.
        gaps_ms: pauses between queries, one after the other.

    Raises:
        Unavailable: a server stopped answering; the text names it.
    """
    first = number % len(servers)
    figures = {}
    for server in [*servers[first:], *servers[:first]]:
        try:
            figures[server.name] = measure(server, seconds, gaps_ms)
        except Unavailable as error:
            raise Unavailable(f"{server.name} stopped answering: {error}") from None
    return Round(figures, _measure_bare(predict, windows, seconds))


def measure(server: ServerUnderTest, seconds: float, gaps_ms: Sequence[float]) -> Figures:
    """One server's turn.

    Raises:
        Unavailable: its client ended.
    """
    sequential, sequential_cpu_s = _requested(server, do="sequential", rows=1, seconds=seconds)
    in_flight, in_flight_cpu_s = _requested(server, do="in_flight", at_once=AT_ONCE, seconds=seconds)
    bulk, _ = _requested(server, do="sequential", rows=BULK_ROWS, seconds=seconds)
    batch, _ = _requested(server, do="sequential", rows=BATCH_ROWS, seconds=seconds)
    gaps = {}
    for gap_ms in gaps_ms:
        queries, cpu_s = sequential, sequential_cpu_s
        if gap_ms:
            queries, cpu_s = _requested(server, do="sequential", rows=1, seconds=seconds, gap_ms=gap_ms)
        p50_ms, p99_ms = np.percentile(queries["latencies"], (50, 99)) * 1e3
        gaps[f"{gap_ms:g}"] = Gap(float(p50_ms), float(p99_ms), cpu_s / queries["queries"] * 1e6)
    return Figures(
        sequential_p50_ms=median(sequential["latencies"]) * 1e3,
        sequential_cpu_us=sequential_cpu_s / sequential["queries"] * 1e6,
        in_flight_per_s=in_flight["queries"] / in_flight["seconds"],
        in_flight_cpu_us=in_flight_cpu_s / in_flight["queries"] * 1e6,
        bulk_p50_ms=median(bulk["latencies"]) * 1e3,
        batch_p50_ms=median(batch["latencies"]) * 1e3,
        gaps=gaps,
    )


def _requested(server: ServerUnderTest, **what: Any) -> tuple[dict[str, Any], float]:
    """What the client answers to an order, and the server's processor time meanwhile."""
    before = server.process.cpu_seconds()
    answer = server.client.request(**what)
    return answer, server.process.cpu_seconds() - before


def _measure_bare(predict: Predict, windows: NDArray[np.float32], seconds: float) -> BareRuntime:
    return BareRuntime(
        _median_ms(predict, windows[:1], seconds / 2), _median_ms(predict, windows[:BULK_ROWS], seconds / 2)
    )


def _median_ms(predict: Predict, windows: NDArray[np.float32], seconds: float) -> float:
    taken: list[float] = []
    until = time.perf_counter() + seconds
    predict(windows)
    while (start := time.perf_counter()) < until or not taken:
        predict(windows)
        taken.append(time.perf_counter() - start)
    return median(taken) * 1e3

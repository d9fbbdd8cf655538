"""Rounds: in each, the contenders and the bare runtime have a turn, one after the other."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import Unavailable
from taxel_bench.compare.contenders import Contender
from taxel_bench.compare.figures import Figures

AT_ONCE: Final = 64
BULK_ROWS: Final = 1000

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
        figures: of each contender, by its name.
        bare: of the runtime.
    """

    figures: dict[str, Figures]
    bare: BareRuntime


def play_round(
    number: int,
    contenders: Sequence[Contender],
    predict: Predict,
    windows: NDArray[np.float32],
    seconds: float,
) -> Round:
    """One round; whose turn is first changes from round to round.

    Args:
        number: of the round, from 0.
        predict: the bare runtime.
        windows: (m, f), at least `BULK_ROWS`.
        seconds: of each of a contender's three measurements.

    Raises:
        Unavailable: a contender stopped answering; the text names it.
    """
    first = number % len(contenders)
    figures = {}
    for contender in [*contenders[first:], *contenders[:first]]:
        try:
            figures[contender.name] = measure(contender, seconds)
        except Unavailable as error:
            raise Unavailable(f"{contender.name} stopped answering: {error}") from None
    return Round(figures, _measure_bare(predict, windows, seconds))


def measure(contender: Contender, seconds: float) -> Figures:
    """One contender's turn.

    Raises:
        Unavailable: its client ended.
    """
    sequential, sequential_cpu_s = _ordered(contender, do="sequential", rows=1, seconds=seconds)
    in_flight, in_flight_cpu_s = _ordered(contender, do="in_flight", at_once=AT_ONCE, seconds=seconds)
    bulk, _ = _ordered(contender, do="sequential", rows=BULK_ROWS, seconds=seconds)
    return Figures(
        sequential_p50_ms=median(sequential["latencies"]) * 1e3,
        sequential_cpu_us=sequential_cpu_s / sequential["queries"] * 1e6,
        in_flight_per_s=in_flight["queries"] / in_flight["seconds"],
        in_flight_cpu_us=in_flight_cpu_s / in_flight["queries"] * 1e6,
        bulk_p50_ms=median(bulk["latencies"]) * 1e3,
    )


def _ordered(contender: Contender, **what: Any) -> tuple[dict[str, Any], float]:
    """What the client answers to an order, and the server's processor time meanwhile."""
    before = contender.server.cpu_seconds()
    answer = contender.client.order(**what)
    return answer, contender.server.cpu_seconds() - before


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

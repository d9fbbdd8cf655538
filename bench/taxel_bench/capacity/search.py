"""Searches for how many fingers a server carries: it doubles, and then bisects."""

import math
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
import psutil

from taxel.protocol import MAX_ROWS
from taxel.remote.options import Transport
from taxel_bench.capacity.clients import Steps, step_loop
from taxel_bench.server_process import RunningServer
from taxel_bench.verdict import queries_for, verdict

FIRST: Final = 32
"""Fingers of the first attempt."""

CLOSE: Final = 1.1
"""The search ends where the least that does not fit is at most so many times the most that does."""

LATE_SHARE: Final = 0.01
LATE_STEPS: Final = 0.25
"""A generator that wakes by more than so much of a step too late, more often than that, is itself late."""

MOST_OTHERS: Final = 0.1
"""Processors that other programs may take in the mean."""

TRIES: Final = 2
MOST_TRIES: Final = 5
"""A number does not fit if so many attempts failed while nothing else ran, or so many in all."""

_HEAD_START_S: Final = 0.2


@dataclass(frozen=True)
class Attempt:
    """So many fingers, asked for a while.

    Attributes:
        fingers: of all clients together.
        fits: whether p99 was below one step, and every request answered.
        p99_ms: of latencies, from when a step was due; None without an answer.
        generator_late: the share of steps for which the load generator itself woke late.
        errors: by code.
        server_cpu: processors that the server used in the mean.
        others_cpu: processors that programs used which have no part in this, on this machine or, where it
            is a virtual one, on its host.
    """

    fingers: int
    fits: bool
    p99_ms: float | None
    generator_late: float
    errors: dict[str, int]
    server_cpu: float
    others_cpu: float

    @property
    def disturbed(self) -> bool:
        """Whether other programs took too much for it to say that the fingers do not fit."""
        return self.others_cpu > MOST_OTHERS


@dataclass(frozen=True)
class Generator:
    """Client processes, and the server that they ask."""

    pool: ProcessPoolExecutor
    server: RunningServer
    clients: int
    seconds: float

    def try_fingers(self, model: str, transport: Transport, rate: float, fingers: int) -> Attempt:
        """Ask for so many fingers for a while; each client has its part of them in one request a step."""
        clients = min(self.clients, fingers)
        shares = [fingers // clients + (client < fingers % clients) for client in range(clients)]
        steps = max(math.ceil(rate * self.seconds), math.ceil(queries_for(99) / clients))
        ours = psutil.Process()
        server = psutil.Process(self.server.pid)
        start = time.perf_counter() + _HEAD_START_S
        # Clients that are not in step with each other.
        starts = [start + client / clients / rate for client in range(clients)]
        before = _cpu_s(server), _cpu_s_of_family(ours), _busy_s()
        running = [
            self.pool.submit(step_loop, self.server.endpoint, transport, model, share, rate, begin, steps)
            for share, begin in zip(shares, starts, strict=True)
        ]
        told = [each.result() for each in running]
        seconds = time.perf_counter() - start
        after = _cpu_s(server), _cpu_s_of_family(ours), _busy_s()
        of_server, of_family, busy = (
            (end - begin) / seconds for begin, end in zip(before, after, strict=True)
        )
        return _attempt(fingers, told, 1e3 / rate, of_server, max(busy - of_family, 0.0))


def _attempt(
    fingers: int, told: list[Steps], step_ms: float, server_cpu: float, others_cpu: float
) -> Attempt:
    latencies = np.concatenate([each.latency_ms for each in told])
    woke = np.concatenate([each.woke_late_ms for each in told])
    errors = {code: count for each in told for code, count in each.errors.items()}
    p99 = float(np.percentile(latencies, 99)) if len(latencies) else None
    late = float(np.mean(woke > LATE_STEPS * step_ms)) if len(woke) else 0.0
    fits = p99 is not None and p99 < step_ms and not errors
    return Attempt(fingers, fits, p99, late, errors, server_cpu, others_cpu)


def find_capacity(ask: Callable[[int], Attempt], most: int = MAX_ROWS) -> tuple[int, list[Attempt]]:
    """The most fingers that fit, 0 if not even one does; and all attempts.

    A number that does not fit is tried again, as another program may have disturbed it.

    Args:
        ask: tries a number of fingers.
        most: that are tried.
    """
    attempts: list[Attempt] = []

    def fits(fingers: int) -> bool:
        undisturbed = 0
        for _ in range(MOST_TRIES):
            attempts.append(ask(fingers))
            if attempts[-1].fits:
                return True
            undisturbed += not attempts[-1].disturbed
            if undisturbed == TRIES:
                break
        return False

    low, high = 0, most + 1
    fingers = min(FIRST, most)
    while low < most and high - low > 1 and (low == 0 or high > min(CLOSE * low, most)):
        if fits(fingers):
            low = fingers
        else:
            high = fingers
        if high > most:
            fingers = min(2 * low, most)
        elif low:
            fingers = max(round(math.sqrt(low * high)), low + 1)
        else:
            fingers = high // 2
    return low, attempts


def result_of(
    model: str, transport: Transport, rate: float, fingers: int, attempts: list[Attempt], most: int
) -> dict[str, Any]:
    """A row of the table.

    A generator that is late, and other programs, only add to latencies. So what fits, fits; but the bound
    above it is not to be trusted, and the row is INVALID.
    """
    above = [attempt for attempt in attempts if not attempt.fits and attempt.fingers > fingers]
    best = next((attempt for attempt in attempts if attempt.fits and attempt.fingers == fingers), None)
    reasons = []
    if above:
        nearest = min(above, key=lambda each: (each.fingers, each.disturbed, each.generator_late))
        if nearest.generator_late > LATE_SHARE:
            reasons.append(
                f"at {nearest.fingers} fingers the load generator woke late for "
                f"{nearest.generator_late * 100:.3g}% of the steps: at most {LATE_SHARE:.0%} is allowed"
            )
        if nearest.disturbed:
            reasons.append(
                f"at {nearest.fingers} fingers other programs took {nearest.others_cpu:.2g} processors: "
                f"at most {MOST_OTHERS:g} is allowed"
            )
    else:
        reasons.append(f"{most} fingers fit, and more were not tried")
    return {
        "model": model,
        "transport": transport,
        "rate_hz": rate,
        "fingers": fingers,
        "p99_ms": best.p99_ms if best else None,
        "server_cpu": best.server_cpu if best else None,
        **verdict(reasons),
        "trials": [asdict(attempt) for attempt in attempts],
    }


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _cpu_s_of_family(process: psutil.Process) -> float:
    """Of a process and all that it has started: server and clients."""
    total = _cpu_s(process)
    for child in process.children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            total += _cpu_s(child)
    return total


def _busy_s() -> float:
    """The time that all processors ran programs, or that a virtual machine's host took from them."""
    times = psutil.cpu_times()
    return float(times.user + times.system + getattr(times, "nice", 0.0) + getattr(times, "steal", 0.0))

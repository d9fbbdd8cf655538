"""What runs in a client process of `bench capacity`: loops whose requests hold several fingers' windows.

Times are seconds on `time.perf_counter`, which is the same clock in all processes of a machine.
"""

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from taxel.errors import RequestError
from taxel.remote import RemotePredictor, RemoteSource
from taxel.remote.options import Transport
from taxel_bench.windows import random_windows

TIMEOUT_S: Final = 2.0

_sources: dict[tuple[str, Transport], RemoteSource] = {}
"""Of this process; each is connected once."""


@dataclass
class Steps:
    """What became of the steps of one process.

    Attributes:
        latency_ms: of each answer, from when its step was due.
        woke_late_ms: how late the loop woke for each step that it slept for.
        errors: by code.
    """

    latency_ms: list[float] = field(default_factory=list)
    woke_late_ms: list[float] = field(default_factory=list)
    errors: Counter[str] = field(default_factory=Counter)


def predictor_of(endpoint: str, transport: Transport, model: str) -> RemotePredictor:
    """A predictor over this process's own connection."""
    source = _sources.get((endpoint, transport))
    if source is None:
        source = RemoteSource(endpoint, timeout=TIMEOUT_S, transport=transport)
        _sources[endpoint, transport] = source
    return source.predictor(model)


def step_loop(
    endpoint: str,
    transport: Transport,
    model: str,
    fingers: int,
    rate: float,
    start: float,
    steps: int,
) -> Steps:
    """Ask for all fingers in one request in each step; a step that is due meanwhile is asked at once."""
    told = Steps()
    predictor = predictor_of(endpoint, transport, model)
    windows = random_windows(predictor.manifest, fingers, 0)
    for step in range(steps):
        due = start + step / rate
        now = time.perf_counter()
        # Twice the allowed time is over: it does not fit, and the rest would only take longer.
        if now - due > 2 * max(steps / rate, 1):
            told.errors["NOT_SENT"] += steps - step
            break
        if now < due:
            time.sleep(due - now)
            told.woke_late_ms.append((time.perf_counter() - due) * 1e3)
        try:
            predictor.predict(windows)
        except RequestError as error:
            told.errors[error.code] += 1
        else:
            told.latency_ms.append((time.perf_counter() - due) * 1e3)
    return told


def ask_in_turn(endpoint: str, transport: Transport, model: str, rows: int, seconds: float) -> list[float]:
    """Send one request after the other; seconds that each took.

    Raises:
        RequestError: one was not answered.
    """
    predictor = predictor_of(endpoint, transport, model)
    windows = random_windows(predictor.manifest, rows, 0)
    predictor.predict(windows)
    taken: list[float] = []
    ends = time.perf_counter() + seconds
    while (asked := time.perf_counter()) < ends:
        predictor.predict(windows)
        taken.append(time.perf_counter() - asked)
    return taken

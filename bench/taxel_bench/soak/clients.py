"""What runs in a client process of `bench soak`: a control loop, or visitors that come, ask and go.

Times are seconds on `time.perf_counter`, which is the same clock in all processes of a machine.
"""

import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import taxel
from taxel.errors import RequestError
from taxel.remote.options import Transport
from taxel_bench.windows import random_windows

TIMEOUT_S = 10.0


@dataclass
class Asked:
    """What became of the requests of one process.

    Attributes:
        name: of the client.
        due: when each request was due, seconds from the start.
        latency_ms: of each, from then to its answer; NaN where an error came.
        errors: by code.
    """

    name: str
    due: list[float] = field(default_factory=list)
    latency_ms: list[float] = field(default_factory=list)
    errors: Counter[str] = field(default_factory=Counter)

    def ask(
        self, predictor: taxel.Predictor, windows: NDArray[np.float32], start: float, due: float
    ) -> None:
        """Send a request that was due at a moment, and note what came."""
        try:
            predictor.predict(windows)
        except RequestError as error:
            self.note(error, due - start)
        else:
            self.due.append(due - start)
            self.latency_ms.append((time.perf_counter() - due) * 1e3)

    def note(self, error: RequestError, due: float) -> None:
        """Note an error in place of an answer that was due so many seconds after the start."""
        self.errors[error.code] += 1
        self.due.append(due)
        self.latency_ms.append(float("nan"))


def control_loop(
    endpoint: str, transport: Transport, model: str, rate: float, start: float, seconds: float
) -> Asked:
    """Ask for one window in each step, as a robot does. A step that is due meanwhile is skipped."""
    asked = Asked(f"control loop, {transport}")
    with taxel.connect(endpoint, transport=transport, timeout=TIMEOUT_S) as source:
        predictor = source.predictor(model)
        windows = random_windows(predictor.manifest, 1, 0)
        due = start
        while due < start + seconds:
            _sleep_until(due)
            asked.ask(predictor, windows, start, due)
            behind = max(int((time.perf_counter() - due) * rate), 0)
            due += (behind + 1) / rate
    return asked


def visitors(
    endpoint: str, transport: Transport, model: str, rows: int, pause_s: float, start: float, seconds: float
) -> Asked:
    """Come, ask for many windows, and go; again and again."""
    asked = Asked(f"visitors, {transport}")
    due = start
    while due < start + seconds:
        _sleep_until(due)
        try:
            with taxel.connect(endpoint, transport=transport, timeout=TIMEOUT_S) as source:
                predictor = source.predictor(model)
                windows = random_windows(predictor.manifest, rows, 0)
                # Of a visit, only the request is timed: connecting has no deadline.
                asked.ask(predictor, windows, start, time.perf_counter())
        except RequestError as error:
            asked.note(error, due - start)
        due = max(due + pause_s, time.perf_counter())
    return asked


def _sleep_until(moment: float) -> None:
    if (left := moment - time.perf_counter()) > 0:
        time.sleep(left)

"""What runs in a client process of `bench chaos`: it is connected once, then sends as it is told.

A process has one connection, made by `connect`. Times are seconds on `time.perf_counter`, which is the
same clock in all processes of a machine.
"""

import os
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from threading import Semaphore
from typing import Any, Final

from taxel.commands.top import read_statistics
from taxel.errors import RequestError
from taxel.protocol import model_key, pack_infer_request
from taxel.remote import RemoteSource
from taxel_bench.chaos.flooders import sender
from taxel_bench.windows import random_windows

_connected: list[RemoteSource] = []

_NICE: Final = 4

_NAP_S: Final = 0.001
"""The shortest time that a flooder sleeps."""

_LANDING_S: Final = 1.0
"""On top of the time-out: how long a process waits for its last answers."""


@dataclass
class Asked:
    """When a request was asked, and when its sender had given all of it to zenoh; 0 until then."""

    at: float
    sent: float = 0.0


@dataclass
class Sent:
    """What became of the requests of one process.

    Attributes:
        requests: that were sent.
        answered: with predictions, within the measured time.
        errors: by code.
        latency_ms: of each answer with predictions.
        refusal_ms: of each refusal, from asking.
        refusal_after_sending_ms: the same, from when the request had been given to zenoh, or 0 if it was
            refused before.
    """

    requests: int = 0
    answered: int = 0
    errors: Counter[str] = field(default_factory=Counter)
    latency_ms: list[float] = field(default_factory=list)
    refusal_ms: list[float] = field(default_factory=list)
    refusal_after_sending_ms: list[float] = field(default_factory=list)

    def add(self, asked: Asked, ends: float, result: bytes | RequestError) -> None:
        """Note an answer that has come now."""
        now = time.perf_counter()
        if isinstance(result, RequestError):
            self.errors[result.code] += 1
            if result.code == "RESOURCE_EXHAUSTED":
                self.refusal_ms.append((now - asked.at) * 1e3)
                self.refusal_after_sending_ms.append((now - asked.sent) * 1e3 if asked.sent else 0.0)
            return
        self.latency_ms.append((now - asked.at) * 1e3)
        self.answered += now <= ends


def connect(endpoint: str, timeout_s: float) -> None:
    """Connect this process; called once, when it starts.

    It gives way to the server, as if it were on another machine.
    """
    with suppress(OSError):
        os.nice(_NICE)
    _connected.append(RemoteSource(endpoint, timeout=timeout_s, transport="zenoh"))


def statistics() -> dict[str, Any]:
    """The server's, since its start."""
    return read_statistics(_connected[0])


def _request(model: str, rows: int, timeout_s: float, seed: int) -> tuple[str, bytes]:
    """A key and a payload."""
    source = _connected[0]
    manifest = source.predictor(model).manifest
    windows = random_windows(manifest, rows, seed)
    return model_key(source.prefix, manifest.name, manifest.version, "infer"), pack_infer_request(
        windows, timeout_ms=timeout_s * 1e3
    )


def saturate(model: str, rows: int, in_flight: int, start: float, seconds: float) -> Sent:
    """Keep so many requests on their way: what is answered is the capacity."""
    source, outcome = _connected[0], Sent()
    key, payload = _request(model, rows, source.timeout, 0)
    free = Semaphore(in_flight)
    ends = start + seconds

    def back(asked: Asked, result: bytes | RequestError) -> None:
        outcome.add(asked, ends, result)
        free.release()

    _sleep_until(start)
    while (sent := time.perf_counter()) < ends:
        if free.acquire(timeout=0.1):
            outcome.requests += 1
            source.connection.send(key, payload, source.timeout, partial(back, Asked(sent)))
    _land(outcome, source.timeout)
    return outcome


def flood(flooder: str, model: str, rows: int, rate: float, start: float, seconds: float) -> Sent:
    """Ask at a rate, whatever is answered.

    It wakes once in a millisecond at most, and sends what is due by then: more would take processor time
    from the server, and from its own reading of answers. What is due while sending is blocked is sent
    afterwards.
    """
    source, outcome = _connected[0], Sent()
    key, payload = _request(model, rows, source.timeout, 1)
    ends = start + seconds
    due = start
    with sender(flooder, source, key) as send:
        while due < ends and (woken := time.perf_counter()) < ends:
            while due <= woken:
                asked = Asked(time.perf_counter())
                if asked.at >= ends:
                    break
                outcome.requests += 1
                send(payload, partial(outcome.add, asked, ends))
                asked.sent = time.perf_counter()
                due += 1 / rate
            # Also if it is late: while Python sends without a pause, it hardly takes the answers.
            time.sleep(max(due - time.perf_counter(), _NAP_S))
        _land(outcome, source.timeout)
    return outcome


def be_polite(model: str, rate: float, start: float, seconds: float) -> Sent:
    """Ask for one window at a rate, one request after the other, as a control loop does."""
    source, outcome = _connected[0], Sent()
    key, payload = _request(model, 1, source.timeout, 2)
    ends, due = start + seconds, start
    while due < ends:
        _sleep_until(due)
        outcome.requests += 1
        try:
            result: bytes | RequestError = source.get(key, payload)
        except RequestError as error:
            result = error
        # The wait counts from when the window was due: a late answer also delays the next windows.
        outcome.add(Asked(due), ends, result)
        due = max(due + 1 / rate, time.perf_counter())
    return outcome


def oversize(model: str, size: int) -> tuple[str, float]:
    """Send one message of so many bytes: the code of its answer, and after how many seconds it came."""
    source = _connected[0]
    key, _ = _request(model, 1, source.timeout, 3)
    started = time.perf_counter()
    try:
        source.get(key, bytes(size))
        code = "OK"
    except RequestError as error:
        code = error.code
    return code, time.perf_counter() - started


def _sleep_until(moment: float) -> None:
    left = moment - time.perf_counter()
    if left > 0:
        time.sleep(left)


def _land(outcome: Sent, timeout_s: float) -> None:
    """Wait for the answers that are still on their way."""
    ends = time.perf_counter() + timeout_s + _LANDING_S
    while len(outcome.latency_ms) + outcome.errors.total() < outcome.requests:
        if time.perf_counter() > ends:
            return
        time.sleep(0.01)

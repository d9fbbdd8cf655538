"""Where each microsecond of a window over the lane goes, at both ends."""

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import taxel
from taxel.errors import Unavailable
from taxel_bench.lane.stamped_server import StampedSocket
from taxel_bench.server_process import ADDRESS, free_port

STAGES: Final = (
    "client: prepare the request",
    "client: send until the server reads (its thread wakes)",
    "server: receive",
    "server: recognise the request",
    "server: check the window",
    "server: evaluate",
    "server: count",
    "server: pack the reply",
    "server: send until the client has it (its thread wakes)",
    "client: unpack the counts",
)

_STAMPS: Final = 10
"""Of the server, for a window that was answered at once."""


def measure_stages(
    repository: Path, model: str, windows: NDArray[np.float32], gap_ms: float, seconds: float
) -> list[float]:
    """Medians of `STAGES`, µs; the stamps themselves take some of it.

    Args:
        repository: that is served.
        model: that is asked.
        windows: (m, f) float32; one a query, in turn.
        gap_ms: pause between an answer and the next query.
        seconds: for so long.

    Raises:
        Unavailable: the server does not start, or answered no window at once.
    """
    endpoint = f"tcp/{ADDRESS}:{free_port()}"
    command = [sys.executable, "-m", "taxel_bench.lane.stamped_server", str(repository), endpoint]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            if server.stdout.readline() != "ready\n":
                raise Unavailable("the stamped server does not start")
            asked = _asked(endpoint, model, windows, gap_ms, seconds)
            answered = json.loads(server.communicate(timeout=30)[0])
        finally:
            server.kill()
    rows = _matched(asked, [each for each in answered if len(each) == _STAMPS])
    if not rows:
        raise Unavailable("the stamped server answered no window at once")
    medians: list[float] = (np.median(rows, axis=0) / 1e3).tolist()
    return medians


def _asked(
    endpoint: str, model: str, windows: NDArray[np.float32], gap_ms: float, seconds: float
) -> list[list[int]]:
    """Of each query: begun, sending, sent, waiting, received, done."""
    asked = []
    with taxel.connect(endpoint, transport="lane") as source:
        predictor = source.predictor(model)
        stamps: list[int] = []
        for row in range(2):
            predictor.predict(windows[row : row + 1])
        lanes = source.core.lanes
        assert lanes is not None
        assert lanes.lane is not None
        (connection,) = lanes.lane.idle
        connection.socket = StampedSocket(connection.socket, stamps)  # type: ignore[assignment]
        until = time.perf_counter() + seconds
        number = 0
        while time.perf_counter() < until:
            window = windows[number % len(windows)][None]
            stamps.clear()
            begun = time.perf_counter_ns()
            predictor.predict(window)
            # The reply is asked for several times.
            sending, sent, waiting, *_, received = stamps
            asked.append([begun, sending, sent, waiting, received, time.perf_counter_ns()])
            number += 1
            if gap_ms:
                time.sleep(gap_ms / 1e3)
    return asked


def _matched(asked: Sequence[Sequence[int]], answered: Sequence[Sequence[int]]) -> list[list[int]]:
    """The time of each stage, of each query that the server answered at once."""
    rows = []
    following = iter(answered)
    theirs = next(following, None)
    for begun, sending, _, _, received, done in asked:
        while theirs is not None and theirs[0] < sending:
            theirs = next(following, None)
        if theirs is not None and theirs[0] < received:
            read, _, got, asked_core, evaluating, evaluated, counted, replying, _, _ = theirs
            moments = begun, sending, read, got, asked_core, evaluating, evaluated, counted, replying
            rows.append(np.diff([*moments, received, done]).tolist())
    return rows

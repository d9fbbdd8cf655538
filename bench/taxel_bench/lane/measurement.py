"""One window in process, over the lane, and through a bare echo, in turn in one run."""

import gc
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import taxel
from taxel.channels import CHANNELS
from taxel.errors import Unavailable
from taxel.lane.frames import HEAD_BYTES, pack_request_head
from taxel.protocol import model_path
from taxel_bench.server_process import running_server

Ask = Callable[[NDArray[np.float32]], object]

WAYS: Final = ("in process", "lane", "echo")


@dataclass(frozen=True)
class Latency:
    """Of one way, at one pause: medians over rounds of each round's percentiles, µs."""

    p50_us: float
    p99_us: float


def measure(
    repository: Path,
    model: str,
    windows: NDArray[np.float32],
    gaps_ms: list[float],
    rounds: int,
    seconds: float,
) -> dict[str, dict[str, Latency]]:
    """Latency by the pause in ms, and by `WAYS`.

    Args:
        repository: with the model.
        model: its name.
        windows: (m, f) float32; one a query, in turn.
        gaps_ms: pauses between an answer and the next query.
        rounds: in each, all ways have a turn at every pause.
        seconds: of each turn.
    """
    queries = [np.ascontiguousarray(window[None]) for window in windows]
    found: dict[str, dict[str, list[tuple[float, float]]]] = {}
    local = taxel.load(repository).predictor(model)
    manifest = local.manifest
    path = model_path(model, manifest.version, "infer")
    request = len(pack_request_head(path, 1, queries[0].shape, 0, spread=False)) + queries[0].nbytes
    reply = HEAD_BYTES + len(CHANNELS) * 4
    with (
        running_server(repository) as endpoint,
        taxel.connect(endpoint, transport="lane") as source,
        _echo(request, reply) as echo,
    ):
        ways: tuple[Ask, ...] = local.predict, source.predictor(model).predict, echo
        for number in range(rounds):
            turns = list(zip(WAYS, ways, strict=True))
            for name, ask in turns[number % 3 :] + turns[: number % 3]:
                for gap_ms in gaps_ms:
                    taken = _latencies(ask, queries, gap_ms, seconds)
                    of_gap = found.setdefault(f"{gap_ms:g}", {})
                    of_gap.setdefault(name, []).append(taken)
    return {
        gap: {name: Latency(*np.median(of_gap[name], axis=0).tolist()) for name in WAYS}
        for gap, of_gap in found.items()
    }


def _latencies(
    ask: Ask, queries: list[NDArray[np.float32]], gap_ms: float, seconds: float
) -> tuple[float, float]:
    """The 50th and the 99th percentile, µs."""
    taken: list[float] = []
    ask(queries[0])
    gc.disable()
    until = time.perf_counter() + seconds
    while (start := time.perf_counter()) < until:
        ask(queries[len(taken) % len(queries)])
        taken.append(time.perf_counter() - start)
        if gap_ms:
            time.sleep(gap_ms / 1e3)
    gc.enable()
    p50, p99 = np.percentile(taken, (50, 99)) * 1e6
    return float(p50), float(p99)


@contextmanager
def _echo(request: int, reply: int) -> Iterator[Ask]:
    """Sends as many bytes as a window's request, and waits for as many as its reply."""
    message = bytes(request)
    with (
        tempfile.TemporaryDirectory(prefix="taxel-echo-") as folder,
        socket.socket(socket.AF_UNIX) as client,
    ):
        path = f"{folder}/echo"
        command = [sys.executable, "-m", "taxel_bench.lane.echo", path, str(reply)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            if process.stdout.readline() != "ready\n":
                raise Unavailable("the echo does not start")
            client.connect(path)

            def ask(_: NDArray[np.float32]) -> bytes:
                client.sendall(message)
                return client.recv(65_536)

            try:
                yield ask
            finally:
                client.close()

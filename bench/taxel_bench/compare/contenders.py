"""A server and its client, side by side: Taxel's or a peer's, started and checked alike."""

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import Unavailable
from taxel_bench.compare.peers import Peer
from taxel_bench.compare.processes import Cores, Program, running_program
from taxel_bench.server_process import ADDRESS, free_port, serve_command

CHECKED_ROWS: Final = 8
"""Windows whose answers are compared before anything is timed."""

_HERE: Final = Path(__file__).resolve().parent
_START_S: Final = 120.0
"""How long a server may take until it answers; Ray starts half a dozen processes."""

_RETRY_S: Final = 0.5
_TOLERANCE: Final = 0.01
"""Counts by which answers may differ; all evaluate the same file, most with ONNX Runtime."""


@dataclass(frozen=True)
class Contender:
    """A server that answers, and a client connected to it."""

    name: str
    server: Program
    client: Program


@dataclass(frozen=True)
class Task:
    """What every contender has to do.

    Attributes:
        model: the ONNX file.
        repository: a repository that holds this model and no other.
        windows: a file of (m, f) float32.
        counts: right answers to the first windows, (`CHECKED_ROWS`, 21).
        cores: that servers and clients are kept on; None for any.
    """

    model: Path
    repository: Path
    windows: Path
    counts: NDArray[np.float32]
    cores: Cores | None


@contextmanager
def taxel_contender(task: Task) -> Iterator[Contender]:
    """Taxel's server and client.

    Raises:
        Unavailable: the server does not start, or answers something else.
    """
    port = free_port()
    serve = serve_command(task.repository, f"tcp/{ADDRESS}:{port}")
    with _contender("taxel", serve, None, sys.executable, "taxel_client", port, task) as contender:
        yield contender


@contextmanager
def peer_contender(peer: Peer, interpreter: Path, task: Task) -> Iterator[Contender]:
    """A peer's server and client.

    Raises:
        Unavailable: the server does not start, or answers something else.
    """
    port = free_port()
    serve = [*_module(str(interpreter), peer.server), "--model", str(task.model)]
    serve += ["--address", ADDRESS, "--port", str(port)]
    client = str(interpreter) if peer.client_needs_packages else sys.executable
    with _contender(peer.name, serve, _HERE, client, peer.client, port, task) as contender:
        yield contender


@contextmanager
def _contender(
    name: str,
    serve: Sequence[str],
    path: Path | None,
    client_interpreter: str,
    client: str,
    port: int,
    task: Task,
) -> Iterator[Contender]:
    ask = [*_module(client_interpreter, client), "--address", ADDRESS, "--port", str(port)]
    ask += ["--windows", str(task.windows)]
    cores = task.cores.servers if task.cores else None
    with running_program(serve, path=path, cores=cores) as server, _connected(ask, server, task) as program:
        yield Contender(name, server, program)


@contextmanager
def _connected(ask: Sequence[str], server: Program, task: Task) -> Iterator[Program]:
    """A client that has got right answers; tries again until the server is ready."""
    ends = time.monotonic() + _START_S
    cores = task.cores.clients if task.cores else None
    while True:
        with running_program(ask, path=_HERE, takes_orders=True, cores=cores) as client:
            try:
                counts = client.order(do="answer", rows=CHECKED_ROWS)["counts"]
            except Unavailable as error:
                reason = str(error)
            else:
                _check(np.array(counts), task.counts)
                yield client
                return
        if not server.runs:
            raise Unavailable(f"its server stopped: {server.last_words()}")
        if time.monotonic() > ends:
            raise Unavailable(f"its server does not answer within {_START_S:g} s: {reason}")
        time.sleep(_RETRY_S)


def _check(counts: NDArray[np.float64], expected: NDArray[np.float32]) -> None:
    if counts.shape != expected.shape:
        raise Unavailable(f"it answers counts {counts.shape}: expected {expected.shape}")
    difference = float(np.abs(counts - expected).max())
    if not difference <= _TOLERANCE:
        raise Unavailable(f"its answers differ by {difference:g} counts: at most {_TOLERANCE} are allowed")


def _module(interpreter: str, module: str) -> list[str]:
    return [interpreter, "-m", f"peer_programs.{module}"]

"""A server and its client, side by side: Taxel's or a peer's, started and checked alike."""

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import Unavailable
from taxel_bench.compare.peers import PeerServer
from taxel_bench.compare.processes import Cores, Program, running_program
from taxel_bench.server_process import ADDRESS, free_port, serve_command

CHECKED_ROWS: Final = 8
"""Windows whose answers are compared before anything is timed."""

ZENOH: Final = "taxel"
LANE: Final = "taxel-lane"
"""Taxel's two transports count as two servers."""

_HERE: Final = Path(__file__).resolve().parent
_START_S: Final = 120.0
"""How long a server may take until it answers; Ray starts half a dozen processes."""

_RETRY_S: Final = 0.5
_TOLERANCE: Final = 0.01
"""Counts by which answers may differ; all evaluate the same file, most with ONNX Runtime."""


@dataclass(frozen=True)
class ServerUnderTest:
    """A server that answers, and a client connected to it."""

    name: str
    process: Program
    client: Program


@dataclass(frozen=True)
class Workload:
    """What every server has to do.

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
def taxel_servers(workload: Workload) -> Iterator[list[ServerUnderTest]]:
    """Taxel's server, once with a client over zenoh and once with a client over the lane.

    Raises:
        Unavailable: the server does not start, or answers something else.
    """
    port = free_port()
    serve = serve_command(workload.repository, f"tcp/{ADDRESS}:{port}")
    with _running(serve, None, workload) as process, ExitStack() as clients:
        servers = []
        for name, transport in ((ZENOH, "zenoh"), (LANE, "lane")):
            ask = [*_asking(sys.executable, "taxel_client", port, workload), "--transport", transport]
            client = clients.enter_context(_connected(ask, process, workload))
            servers.append(ServerUnderTest(name, process, client))
        yield servers


@contextmanager
def peer_server(peer: PeerServer, interpreter: Path, workload: Workload) -> Iterator[ServerUnderTest]:
    """A peer's server and client.

    Raises:
        Unavailable: the server does not start, or answers something else.
    """
    port = free_port()
    serve = [*_module(str(interpreter), peer.server), "--model", str(workload.model)]
    serve += ["--address", ADDRESS, "--port", str(port)]
    ask = _asking(
        str(interpreter) if peer.client_needs_packages else sys.executable, peer.client, port, workload
    )
    with (
        _running(serve, _HERE, workload) as process,
        _connected(ask, process, workload) as program,
    ):
        yield ServerUnderTest(peer.name, process, program)


@contextmanager
def _running(serve: Sequence[str], path: Path | None, workload: Workload) -> Iterator[Program]:
    cores = workload.cores.servers if workload.cores else None
    with running_program(serve, path=path, cores=cores) as process:
        yield process


def _asking(interpreter: str, client: str, port: int, workload: Workload) -> list[str]:
    ask = [*_module(interpreter, client), "--address", ADDRESS, "--port", str(port)]
    return [*ask, "--windows", str(workload.windows)]


@contextmanager
def _connected(ask: Sequence[str], server: Program, workload: Workload) -> Iterator[Program]:
    """A client that has got right answers; tries again until the server is ready."""
    ends = time.monotonic() + _START_S
    cores = workload.cores.clients if workload.cores else None
    while True:
        with running_program(ask, path=_HERE, takes_requests=True, cores=cores) as client:
            try:
                counts = client.request(do="answer", rows=CHECKED_ROWS)["counts"]
            except Unavailable as error:
                reason = str(error)
            else:
                _check(np.array(counts), workload.counts)
                yield client
                return
        if not server.runs:
            raise Unavailable(f"its server stopped: {server.last_log_line()}")
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

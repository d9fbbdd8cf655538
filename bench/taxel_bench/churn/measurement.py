"""Sends clients to a server and watches what the server holds afterwards."""

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import psutil

from taxel.errors import Unavailable
from taxel.remote.options import Transport
from taxel_bench.server_process import RunningServer

IN_ONE_PROCESS: Final = 20
"""Clients in one process; every second process is killed while all its clients wait for answers."""

_SHARED_MEMORY: Final = "/dev/shm/"

_SETTLED_S: Final = 15.0
"""How long the last clients are waited for: zenoh's lease is 10 s, and so long its idle threads live."""

_PAUSE_S: Final = 0.2

_MORE_MEMORY: Final = 32.0
"""MiB by which a server may grow and count as flat: its allocator keeps what large requests took."""


@dataclass(frozen=True)
class Held:
    """What a server holds once its clients have gone.

    Attributes:
        clients: that came and went so far.
        memory_mib: resident memory.
        files: open files.
        threads: threads.
        shared_files: files in the system's shared memory that it maps.
    """

    clients: int
    memory_mib: float
    files: int
    threads: int
    shared_files: int


def let_them_come(
    server: RunningServer,
    model: str,
    transport: Transport,
    clients: int,
    rows: int,
    tell: Callable[[int], None],
) -> list[Held]:
    """Send clients, some at a time; what the server holds before the first and after each process of them.

    After the last one the server has time to notice that its clients have gone.

    Args:
        server: that they ask.
        model: that is asked.
        transport: that clients take.
        clients: in all.
        rows: of a large request.
        tell: how many have gone so far.

    Raises:
        Unavailable: a client got no answer.
    """
    process = psutil.Process(server.pid)
    held = [_held(process, 0)]
    gone = 0
    while gone < clients:
        count = min(IN_ONE_PROCESS, clients - gone)
        _come_and_go(server.endpoint, transport, model, count, rows, killed=len(held) % 2 == 0)
        gone += count
        held.append(_held(process, gone))
        tell(gone)
    ends = time.monotonic() + _SETTLED_S
    while reasons_against(held) and time.monotonic() < ends:
        time.sleep(_PAUSE_S)
        held[-1] = _held(process, gone)
    return held


def reasons_against(held: list[Held]) -> list[str]:
    """Why the server does not count as flat: what the last clients left is more than the first left."""
    early, last = held[1:3], held[-1]
    reasons = []
    memory = early[-1].memory_mib
    if last.memory_mib > memory + _MORE_MEMORY:
        reasons.append(f"memory grew from {memory:.0f} to {last.memory_mib:.0f} MiB")
    for name in ("files", "threads", "shared_files"):
        before, after = min(getattr(each, name) for each in early), getattr(last, name)
        if after > before:
            reasons.append(f"{name.replace('_', ' ')} grew from {before} to {after}")
    return reasons


def _come_and_go(
    endpoint: str, transport: Transport, model: str, clients: int, rows: int, *, killed: bool
) -> None:
    arguments = [endpoint, transport, model, str(clients), str(rows), "stay" if killed else "close"]
    command = [sys.executable, "-m", "taxel_bench.churn.clients", *arguments]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        ready = process.stdout.readline() == "ready\n"
        if killed or not ready:
            process.kill()
        if not ready:
            lines = process.stderr.read().strip().splitlines()
            raise Unavailable(f"a client failed: {lines[-1] if lines else 'it said nothing'}")


def _held(server: psutil.Process, clients: int) -> Held:
    with server.oneshot():
        memory, files, threads = server.memory_info().rss, server.num_fds(), server.num_threads()
        shared = sum(mapped.path.startswith(_SHARED_MEMORY) for mapped in server.memory_maps())
    return Held(clients, memory / 2**20, files, threads, shared)

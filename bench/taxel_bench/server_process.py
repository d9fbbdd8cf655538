"""A real Taxel server in a process of its own, for as long as a block lasts."""

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from taxel.errors import Unavailable

ADDRESS: Final = "127.0.0.1"
"""Where servers that are started here listen."""

ROOM: Final = ("--max-queue-rows", str(2**22), "--max-queue-mib", "4096", "--max-queue-seconds", "3600")
"""Arguments of a server whose queue takes what one process of clients may send at once."""


@contextmanager
def running_server(repository: Path, *arguments: str) -> Iterator[str]:
    """Start `taxel serve` on a free loopback port and yield its endpoint once it is ready.

    Args:
        repository: what it serves.
        arguments: further ones of the command.

    Raises:
        Unavailable: the server stopped before it was ready; its last output says why.
    """
    with running_server_process(repository, *arguments) as server:
        yield server.endpoint


class RunningServer(NamedTuple):
    """Where a server listens, and its process."""

    endpoint: str
    pid: int


@contextmanager
def running_server_process(
    repository: Path, *arguments: str, errors: Path | None = None
) -> Iterator[RunningServer]:
    """As `running_server`, with the server's process beside its endpoint.

    Args:
        repository: what it serves.
        arguments: further ones of the command.
        errors: a file that takes what the server writes to stderr, so also its log.

    Raises:
        Unavailable: the server stopped before it was ready.
    """
    endpoint = f"tcp/{ADDRESS}:{free_port()}"
    process = start_server(repository, endpoint, *arguments, errors=errors)
    try:
        yield RunningServer(endpoint, process.pid)
    finally:
        process.terminate()
        process.communicate()


def start_server(
    repository: Path, endpoint: str, *arguments: str, errors: Path | None = None
) -> subprocess.Popen[str]:
    """Start `taxel serve` at an endpoint; it is ready when this returns.

    Args:
        repository: what it serves.
        endpoint: where it listens.
        arguments: further ones of the command.
        errors: a file that takes what the server writes to stderr, so also its log.

    Raises:
        Unavailable: the server stopped before it was ready; its last output says why.
    """
    return start_command([*serve_command(repository, endpoint), *arguments, "--json"], errors)


def start_command(command: list[str], errors: Path | None = None) -> subprocess.Popen[str]:
    """Start a server that prints one JSON object when it is ready; it is ready when this returns.

    Raises:
        Unavailable: the server stopped before it was ready; its last output says why.
    """
    with ExitStack() as files:
        stderr = subprocess.PIPE if errors is None else files.enter_context(errors.open("w"))
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
    try:
        _wait_until_ready(process)
    except BaseException:
        process.kill()
        process.communicate()
        raise
    return process


def _wait_until_ready(process: subprocess.Popen[str]) -> None:
    """Read the object that `taxel serve --json` prints when it is ready."""
    assert process.stdout is not None
    text = ""
    for line in process.stdout:
        text += line
        try:
            json.loads(text)
        except ValueError:
            continue
        return
    _, errors = process.communicate()
    raise Unavailable(
        f"the server stopped before it was ready: {(errors or '').strip() or 'it said nothing'}"
    )


def serve_command(repository: Path, endpoint: str) -> list[str]:
    """What starts a server of a repository that listens at an endpoint."""
    command = [sys.executable, "-m", "taxel", "serve"]
    return [*command, "--repository", str(repository), "--listen", endpoint]


def free_port() -> int:
    """A port of `ADDRESS` that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((ADDRESS, 0))
        port: int = probe.getsockname()[1]
    return port

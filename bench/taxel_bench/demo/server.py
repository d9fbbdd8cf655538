"""A real Taxel server in a process of its own, for as long as a block lasts."""

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from taxel.errors import Unavailable


@contextmanager
def running_server(repository: Path) -> Iterator[str]:
    """Start `taxel serve` on a free loopback port and yield its endpoint once it is ready.

    Raises:
        Unavailable: the server stopped before it was ready; its own words say why.
    """
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    command = [sys.executable, "-m", "taxel", "serve"]
    command += ["--repository", str(repository), "--listen", endpoint, "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        _wait_until_ready(process)
        yield endpoint
    finally:
        process.terminate()
        process.communicate()


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
    raise Unavailable(f"the server stopped before it was ready: {errors.strip() or 'it said nothing'}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port

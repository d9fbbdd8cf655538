"""Clients that ask much and then stop reading, as a program in a debugger does: how long do others wait?

Run as a program, it is such a client, written with zenoh alone.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Final

import zenoh

from taxel.protocol import model_key, pack_infer_request
from taxel.remote import RemoteSource
from taxel_bench.chaos.bars import Bar
from taxel_bench.chaos.bystander import bar_of_failed, bystanders
from taxel_bench.plain_client import client_config
from taxel_bench.windows import random_windows

STOPPED: Final = 1, 4, 12
"""How many clients stop at the same time."""

LONGEST_MS: Final = 500.0
"""What somebody else may wait."""

_ROWS: Final = 1000
_REQUESTS: Final = 200
_ASKED: Final = "asked"

PAST_LEASES_S: Final = 13.0
"""zenoh ends the connection of a client that reads nothing after 10 s."""


@contextmanager
def stopped_clients(endpoint: str, model: str, count: int) -> Iterator[None]:
    """So many clients, each of its own process, which have asked and stopped at the same time."""
    command = [sys.executable, "-m", __name__, endpoint, model]
    with ExitStack() as running:
        clients = []
        for _ in range(count):
            client = running.enter_context(
                subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            )
            running.callback(client.kill)
            clients.append(client)
        for client in clients:
            assert client.stdout is not None
            assert client.stdout.readline().strip() == _ASKED
        for client in clients:
            assert client.stdin is not None
            client.stdin.write("\n")
            client.stdin.flush()
        yield


def stopped_of(endpoint: str, model: str, count: int) -> dict[str, Any]:
    """So many clients stop reading; the answers of others until their connections have ended, and after."""
    with bystanders(endpoint, model) as several, stopped_clients(endpoint, model, count):
        # Until now new processes took the processors.
        for each in several:
            each.longest_ms = 0.0
        time.sleep(PAST_LEASES_S)
    return {"stopped": count, "bystanders": [each.as_dict() for each in several]}


def bars_of_stopped(result: dict[str, Any]) -> list[Bar]:
    """What must be true of others while clients read nothing."""
    others, beside = result["bystanders"], f"{result['stopped']} that read nothing"
    longest_ms = max(each["longest_ms"] for each in others)
    return [
        Bar(f"clients that behave, beside {beside}: longest wait, ms", longest_ms, LONGEST_MS),
        bar_of_failed(beside, others),
    ]


def _ask_and_stop(endpoint: str, model: str) -> None:
    """Have one answer; once told, send all requests and stop."""
    with RemoteSource(endpoint, transport="zenoh") as source:
        manifest, key = source.predictor(model).manifest, model_key(source.prefix, model, None, "infer")
    payload = pack_infer_request(random_windows(manifest, _ROWS, 3), timeout_ms=5000)
    session = zenoh.open(client_config(endpoint))
    session.get(key, zenoh.handlers.FifoChannel(1), payload=payload, timeout=30.0).recv()
    print(_ASKED, flush=True)
    sys.stdin.readline()
    unread: zenoh.handlers.Callback[zenoh.Reply] = zenoh.handlers.Callback(lambda _: None, indirect=False)
    for _ in range(_REQUESTS):
        session.get(key, unread, payload=payload, timeout=5.0)
    os.kill(os.getpid(), signal.SIGSTOP)


if __name__ == "__main__":
    _ask_and_stop(*sys.argv[1:])

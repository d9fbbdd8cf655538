"""A server that notes when each of its stages begins, for windows over the lane.

    python -m taxel_bench.lane.stamped_server REPOSITORY ENDPOINT

It prints `ready`, and at the end of stdin the stamps of each window that it answered at once: ns of
`time.perf_counter_ns`, whose clock all processes of the machine share on Linux.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from taxel_server.core.batcher import Batcher
from taxel_server.engine import Engine, LoadedModel
from taxel_server.options import ServerOptions
from taxel_server.service import Service
from taxel_server.transports.lane_connection import ClientConnection


class StampedSocket:
    """A socket that notes when it receives and sends.

    Args:
        wrapped: the socket.
        stamps: where times go.
    """

    def __init__(self, wrapped: Any, stamps: list[int]) -> None:
        self._wrapped = wrapped
        for name in ("recv", "recv_into", "send", "sendall"):
            setattr(self, name, stamped(getattr(wrapped, name), stamps))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._wrapped, name)


def stamped(function: Callable[..., Any], stamps: list[int]) -> Callable[..., Any]:
    """The same function, noting when it begins and when it returns."""
    now = time.perf_counter_ns

    def call(*arguments: Any) -> Any:
        stamps.append(now())
        result = function(*arguments)
        stamps.append(now())
        return result

    return call


def main(repository: Path, endpoint: str) -> None:
    """Serve until stdin ends."""
    stamps: list[int] = []
    answered: list[list[int]] = []
    answer_alone = ClientConnection.answer_alone

    def answer(connection: Any) -> bool:
        if not isinstance(connection.socket, StampedSocket):
            connection.socket = StampedSocket(connection.socket, stamps)
        stamps.clear()
        stamps.append(time.perf_counter_ns())
        done = answer_alone(connection)
        if done:
            answered.append([*stamps, time.perf_counter_ns()])
        return done

    changed: dict[type, dict[str, Any]] = {
        ClientConnection: {"answer_alone": answer},
        Batcher: {"evaluate_if_idle": Batcher.evaluate_if_idle},
        LoadedModel: {"evaluate": LoadedModel.evaluate},
    }
    for kind, functions in changed.items():
        for name, function in functions.items():
            setattr(kind, name, function if function is answer else stamped(function, stamps))
    engine = Engine(repository)
    engine.load_all()
    service = Service(engine, ServerOptions(listen=(endpoint,))).start()
    print("ready", flush=True)
    sys.stdin.read()
    json.dump(answered, sys.stdout)
    service.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])

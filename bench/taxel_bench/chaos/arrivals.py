"""A server that notes how long after its arrival each request is refused; run as a module, it is one.

zenoh calls Python where a query arrives, in place of its own channel: this costs processor time, so the
released server does not do it. Everything behind it is the server's.
"""

import json
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, Queue
from threading import Event
from typing import Any, cast

import zenoh
from typing_extensions import override
from zenoh.handlers import Callback, Handler

from taxel.zenoh_process import SIGNAL_CHECK_S
from taxel_bench.server_process import ADDRESS, free_port, start_command
from taxel_server.core.core import Core
from taxel_server.engine import Engine
from taxel_server.memory import limit_arenas
from taxel_server.options import ServerOptions
from taxel_server.transports.zenoh_transport import CHANNEL, ZenohTransport

Refused = tuple[float, float]
"""When a request was refused, on `time.monotonic`, and how many ms after its arrival."""


@contextmanager
def noting_server(repository: Path, refused: list[Refused]) -> Iterator[str]:
    """The endpoint of a server that notes refusals, in a process of its own.

    Args:
        repository: what it serves.
        refused: gets what it refused, once it has ended.
    """
    endpoint = f"tcp/{ADDRESS}:{free_port()}"
    process = start_command([sys.executable, "-m", __name__, str(repository), endpoint])
    try:
        yield endpoint
    finally:
        process.terminate()
        told, _ = process.communicate()
        refused += [(at, ms) for at, ms in json.loads(told or "[]")]


class _Query:
    """A query that notes its refusal; in all else the query itself."""

    def __init__(self, query: zenoh.Query, refused: list[Refused]) -> None:
        self._query = query
        self._refused = refused
        self._arrived = time.monotonic()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._query, name)

    def __enter__(self) -> "_Query":
        self._query.__enter__()
        return self

    def __exit__(self, *error: object) -> Any:
        return self._query.__exit__(*error)  # type: ignore[no-untyped-call]

    def reply_err(self, payload: bytes) -> None:
        self._query.reply_err(payload)
        now = time.monotonic()
        if b"RESOURCE_EXHAUSTED" in payload:
            self._refused.append((now, (now - self._arrived) * 1e3))


class _Arrivals:
    """What zenoh's channel is in the released server, and as long."""

    def __init__(self, session: zenoh.Session, key: str, refused: list[Refused]) -> None:
        self.handler = self
        self._queue: Queue[_Query | None] = Queue(CHANNEL)
        arrive: Callback[zenoh.Query] = Callback(
            lambda query: self._queue.put(_Query(query, refused)), indirect=False
        )
        self._queryable = session.declare_queryable(key, arrive, complete=True)

    def undeclare(self) -> None:
        self._queryable.undeclare()  # type: ignore[no-untyped-call]
        self._queue.put(None)

    def recv(self) -> _Query:
        return self._found(self._queue.get())

    def try_recv(self) -> _Query | None:
        with suppress(Empty):
            return self._found(self._queue.get_nowait())
        return None

    def _found(self, query: _Query | None) -> _Query:
        if query is None:
            raise zenoh.ZError("the channel is closed")
        return query


class _Transport(ZenohTransport):
    def __init__(self, core: Core, options: ServerOptions) -> None:
        super().__init__(core, options)
        self.refused: list[Refused] = []

    @override
    def declare(self, session: zenoh.Session, key: str) -> zenoh.Queryable[Handler[zenoh.Query]]:
        return cast("zenoh.Queryable[Handler[zenoh.Query]]", _Arrivals(session, key, self.refused))


def serve(repository: Path, endpoint: str) -> list[Refused]:
    """Serve until SIGTERM, over zenoh alone; the refusals for a full queue."""
    limit_arenas()
    stop = Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    options = ServerOptions(repository=repository, listen=(endpoint,))
    core = Core(Engine(repository), options)
    transport = _Transport(core, options)
    transport.listen()
    core.start()
    transport.start()
    core.ready = True
    print(json.dumps({"listen": endpoint}), flush=True)
    # The system may give the signal to a thread of zenoh's. Python handles it here, once this one wakes.
    while not stop.wait(SIGNAL_CHECK_S):
        pass
    transport.withdraw()
    core.drain()
    transport.close()
    return transport.refused


if __name__ == "__main__":
    print(json.dumps(serve(Path(sys.argv[1]), sys.argv[2])), flush=True)

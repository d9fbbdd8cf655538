"""Several servers of the same models: which there are, and which one is asked next.

Each server has keys of its own, and a liveliness token that tells of them. Of two that are drawn, the one
is asked whose answer is expected sooner: the power of two choices (Mitzenmacher 2001, IEEE Transactions on
Parallel and Distributed Systems 12:10). It spreads requests nearly as evenly as looking at all would, and
many clients do not all run to the same server.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from random import Random
from threading import Event, Lock, Thread
from typing import ClassVar, Final, Literal, NamedTuple

from typing_extensions import override

from taxel.errors import RequestError
from taxel.protocol import REPLICAS
from taxel.remote.query_transport import Done, QueryTransport, nothing_to_give_up
from taxel.remote.zenoh_connection import Connection

_LEAST_S: Final = 1e-4
"""The least latency that is expected, as of a server that has not answered yet: it is soon tried."""

_NEW_SHARE: Final = 0.2
"""How much of the latency the newest answer tells."""

_HALF_LIFE_S: Final = 1.0
"""A latency that is not confirmed is halved in this time, so that a server that was slow gets a chance."""

_AGAIN_S: Final = 0.5
"""Between two attempts to reach an endpoint where nobody listened."""


class Load(NamedTuple):
    """What a client knows of a server's load.

    Attributes:
        outstanding: questions of this client that it has not answered.
        latency_s: how long its recent answers took.
    """

    outstanding: int
    latency_s: float

    @property
    def expected_s(self) -> float:
        """When the next answer is expected, if questions are answered one after the other."""
        return (self.outstanding + 1) * self.latency_s


def draw_two(count: int, draw: Callable[[int], int]) -> tuple[int, int]:
    """Two different numbers below `count`, each pair as likely as any; one twice if there is no other.

    Args:
        count: above 0.
        draw: a random number below its argument.
    """
    first = draw(count)
    return (first, first) if count == 1 else (first, (first + 1 + draw(count - 1)) % count)


def sooner(loads: Sequence[Load], first: int, second: int) -> int:
    """Which of two servers is expected to answer sooner; the first if it is a tie."""
    return second if loads[second].expected_s < loads[first].expected_s else first


class Replica:
    """One of several servers.

    Args:
        connection: reaches it.
        prefix: the servers' key prefix.
        server: its id.
    """

    def __init__(self, connection: Connection, prefix: str, server: str) -> None:
        self.connection = connection
        self.server = server
        self._prefix = prefix
        self._outstanding = 0
        self._latency_s = _LEAST_S
        self._confirmed = time.monotonic()
        self._lock = Lock()

    def key(self, key: str) -> str:
        """The key of this server alone, for a key of any of them."""
        return f"{self._prefix}/{REPLICAS}/{self.server}{key.removeprefix(self._prefix)}"

    @property
    def load(self) -> Load:
        """What is known of its load now."""
        age = time.monotonic() - self._confirmed
        return Load(self._outstanding, max(self._latency_s * 0.5 ** (age / _HALF_LIFE_S), _LEAST_S))

    def asked(self) -> None:
        """A question goes out; `done` must follow."""
        with self._lock:
            self._outstanding += 1

    def done(self, took_s: float, *, answered: bool) -> None:
        """A question has ended after some seconds, with an answer or without.

        A server that refuses at once must not look fast.
        """
        with self._lock:
            self._outstanding -= 1
            known = self.load.latency_s
            self._latency_s = known + _NEW_SHARE * (took_s - known) if answered else max(2 * known, took_s)
            self._confirmed = time.monotonic()


class Choice(NamedTuple):
    """A server to ask, and whether there is no other that was not tried."""

    replica: Replica
    last: bool


class Replicas(QueryTransport):
    """Connections to several servers, or to a router with servers behind it. Thread-safe.

    Args:
        opened: connections; those of `missing` are added once they can be had.
        prefix: the servers' key prefix.
        missing: endpoints where nobody listened.
        open_connection: opens one of those; raises `RequestError` if it cannot.
        seed: of the draws; if none, every client draws differently.
    """

    name: ClassVar[Literal["zenoh", "memory"]] = "zenoh"

    def __init__(
        self,
        opened: Iterable[Connection],
        prefix: str,
        missing: Sequence[str] = (),
        open_connection: Callable[[str], Connection] | None = None,
        seed: int | None = None,
    ) -> None:
        self._connections = list(opened)
        self._prefix = prefix
        self._random = Random(seed)
        self._replicas: dict[str, Replica] = {}
        self._lock = Lock()
        self._closed = Event()
        self.endpoint = ", ".join([*(each.endpoint for each in self._connections), *missing])
        if missing and open_connection is not None:
            Thread(
                target=self._open_missing,
                args=(list(missing), open_connection),
                name="taxel-replicas",
                daemon=True,
            ).start()

    @property
    @override
    def connected(self) -> bool:
        return any(each.connected for each in self._connections)

    def alive(self) -> list[Replica]:
        """The servers that are there, as far as it is known."""
        found: dict[str, Replica] = {}
        with self._lock:
            for connection in self._connections:
                for server in connection.servers():
                    if server not in found:
                        known = self._replicas.get(server)
                        if known is None or known.connection is not connection:
                            known = Replica(connection, self._prefix, server)
                        found[server] = known
            self._replicas = found
        return list(found.values())

    def choose(self, tried: Iterable[str] = ()) -> "Choice | None":
        """The server to ask next; None if there is none besides those that were tried."""
        left = [each for each in self.alive() if each.server not in tried]
        if not left:
            return None
        chosen = sooner([each.load for each in left], *draw_two(len(left), self._random.randrange))
        return Choice(left[chosen], len(left) == 1)

    @override
    def start(
        self, key: str, payload: bytes | None, timeout: float, cancel_key: str | None = None
    ) -> Callable[[], bytes]:
        replica = self._any(key)
        own_cancel = None if cancel_key is None else replica.key(cancel_key)
        return replica.connection.start(replica.key(key), payload, timeout, own_cancel)

    @override
    def send(
        self, key: str, payload: bytes | None, timeout: float, done: Done, cancel_key: str | None = None
    ) -> Callable[[], None]:
        try:
            replica = self._any(key)
        except RequestError as error:
            done(error)
            return nothing_to_give_up
        own_cancel = None if cancel_key is None else replica.key(cancel_key)
        return replica.connection.send(replica.key(key), payload, timeout, done, own_cancel)

    @override
    def silence(self, key: str) -> RequestError:
        connected = [each for each in self._connections if each.connected]
        return (connected or self._connections)[0].silence(key)

    @override
    def close(self) -> None:
        self._closed.set()
        with self._lock:
            for connection in self._connections:
                connection.close()

    def _any(self, key: str) -> Replica:
        choice = self.choose()
        if choice is None:
            raise self.silence(key)
        return choice.replica

    def _open_missing(self, missing: list[str], open_connection: Callable[[str], Connection]) -> None:
        while missing and not self._closed.wait(_AGAIN_S):
            for endpoint in tuple(missing):
                try:
                    opened = open_connection(endpoint)
                except RequestError:
                    continue
                with self._lock:
                    if self._closed.is_set():
                        opened.close()
                        return
                    self._connections.append(opened)
                missing.remove(endpoint)

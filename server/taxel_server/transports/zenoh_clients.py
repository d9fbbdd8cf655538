"""Who asks over zenoh: a client tells its session in each query, and zenoh tells which there are."""

import time
from collections.abc import Callable, Hashable
from math import inf
from threading import Lock
from typing import Final, NamedTuple

import zenoh

ANONYMOUS: Final = "anonymous"
"""Everybody who tells no session, or one that is not connected to this server."""

_LOOK_S: Final = 1e-4
"""How often zenoh is asked who is connected, at most: it takes 4 µs and more for many sessions."""


class Asker(NamedTuple):
    """Who asks, and how they call their query.

    Attributes:
        client: who has a share.
        name: of the query, if it is given up; None if it cannot be. Nobody else knows the session's id.
    """

    client: str
    name: tuple[str, int] | None


class ZenohClients:
    """Knows the connected sessions between `watch` and `close`.

    Args:
        gone: told each session that has ended.

    Attributes:
        connected: the sessions that are connected now.
    """

    def __init__(self, gone: Callable[[Hashable], None]) -> None:
        self._gone = gone
        self.connected: set[str] = set()
        self._lock = Lock()
        self._looked = -inf

    def watch(self, session: zenoh.Session) -> None:
        """Hear of sessions that connect and end. zenoh has a thread for this."""
        self._session = session
        self._listener = session.info.declare_transport_events_listener(self._note, history=True)

    def close(self) -> None:
        """Hear of nothing more."""
        self._listener.undeclare()  # type: ignore[no-untyped-call]

    def asker_of(self, query: zenoh.Query) -> Asker:
        """Whose query this is. A session that is not connected has no share: it could be invented."""
        source = query.source_info
        if source is None:
            return Asker(ANONYMOUS, None)
        told, number = str(source.source_id.zid), source.source_sn
        if told not in self.connected:
            self._look()
        return Asker(told if told in self.connected else ANONYMOUS, (told, number) if number else None)

    def _look(self) -> None:
        """Ask zenoh who is connected: it tells of a new session a moment after its first queries."""
        with self._lock:
            now = time.monotonic()
            if now - self._looked >= _LOOK_S:
                self._looked = now
                self.connected |= {str(each.zid) for each in self._session.info.transports()}

    def _note(self, event: zenoh.TransportEvent) -> None:
        session = str(event.transport.zid)
        with self._lock:
            if event.kind == zenoh.SampleKind.PUT:
                self.connected.add(session)
                return
            self.connected.discard(session)
        self._gone(session)

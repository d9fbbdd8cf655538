"""Who asks over zenoh: a client tells its session in each query, and zenoh tells which there are."""

from collections.abc import Callable, Hashable
from typing import Final

import zenoh

ANONYMOUS: Final = "anonymous"
"""Everybody who tells no session, or one that is not connected to this server."""


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

    def watch(self, session: zenoh.Session) -> None:
        """Hear of sessions that connect and end. zenoh has a thread for this."""
        self._listener = session.info.declare_transport_events_listener(self._note, history=True)

    def close(self) -> None:
        """Hear of nothing more."""
        self._listener.undeclare()  # type: ignore[no-untyped-call]

    def client_of(self, query: zenoh.Query) -> str:
        """Whose query this is. A session that is not connected has no share: it could be invented."""
        source = query.source_info
        if source is None:
            return ANONYMOUS
        told = str(source.source_id.zid)
        return told if told in self.connected else ANONYMOUS

    def _note(self, event: zenoh.TransportEvent) -> None:
        session = str(event.transport.zid)
        if event.kind == zenoh.SampleKind.PUT:
            self.connected.add(session)
        else:
            self.connected.discard(session)
            self._gone(session)

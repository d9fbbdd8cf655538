"""Ends the queries of a transport that closes: some of them zenoh would keep until their timeout."""

import zenoh
from zenoh.handlers import Callback


class TransportWatch:
    """Hears when a session's transport to its server, or to a router, closes.

    zenoh forgets a transport as it begins to close it, but gives it queries until it has closed it. These
    are never sent, and those that come just after the open ones were ended wait for their own timeout.

    Args:
        session: the client's; it has one transport at a time.

    Attributes:
        token: goes with each query, and cancels it when the transport closes that it was sent over.
        listener: hears it.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self.token = zenoh.CancellationToken()
        noted: Callback[zenoh.TransportEvent] = Callback(self.note, indirect=False)
        self.listener = session.info.declare_transport_events_listener(noted)

    @property
    def is_open(self) -> bool:
        """Whether a query can be sent now."""
        return bool(self._session.info.routers_zid() or self._session.info.peers_zid())

    def has_closed(self, token: zenoh.CancellationToken) -> bool:
        """Whether the transport has closed that was there when this was the token."""
        return token is not self.token

    def note(self, event: zenoh.TransportEvent) -> None:
        """A transport opened or closed."""
        if event.kind == zenoh.SampleKind.DELETE:
            self.end_queries()

    def end_queries(self) -> None:
        """End all queries that were sent so far."""
        before, self.token = self.token, zenoh.CancellationToken()
        before.cancel()  # type: ignore[no-untyped-call]

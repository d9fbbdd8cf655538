"""Which servers a session knows of: only their answers count."""

import time
from contextlib import suppress
from math import inf
from typing import Final

import zenoh
from zenoh.handlers import Callback

from taxel.protocol import REPLICAS

TIMEOUT: Final = b"Timeout"
"""The error that zenoh makes itself when a query's time is over."""

_LOOK_S: Final = 1.0
"""The longest that a look for servers takes. Where there are none, it ends at once."""

_AGAIN_S: Final = 0.1
"""How often to look again where no server is left."""


class KnownServers:
    """Servers of a prefix: the one that the session is connected to, and those whose tokens it sees.

    A server's access control lets no client declare a token. Behind a router, the router's access control
    decides who may.

    Args:
        session: the client's session.
        prefix: the servers' key prefix.

    Attributes:
        alive: those whose tokens it sees now.
        lost_at: when it last lost sight of one, on `time.monotonic`.
        subscriber: hears of servers that come and go.
    """

    def __init__(self, session: zenoh.Session, prefix: str) -> None:
        self._session = session
        self._looked = -inf
        # A server that is stopping still answers what it was asked: so nobody is forgotten.
        self._seen: set[str] = set()
        self.alive: set[str] = set()
        self.lost_at = -inf
        self._tokens = f"{prefix}/{REPLICAS}/*"
        liveliness = session.liveliness()
        self.subscriber = liveliness.declare_subscriber(
            self._tokens, Callback(self._note, indirect=False), history=True
        )
        for reply in liveliness.get(self._tokens, timeout=_LOOK_S):
            self._note_reply(reply)

    @property
    def gone(self) -> bool:
        """Whether it has seen servers, and sees none now: they are gone, or known again in a moment."""
        return bool(self._seen) and not self.current()

    def current(self) -> set[str]:
        """Those that are alive. Where all are gone, it looks for them again.

        zenoh tells of the tokens when it connects again. It may miss them where the old connection ends
        after the new one has begun.
        """
        if self._seen and not self.alive and time.monotonic() - self._looked > _AGAIN_S:
            self._looked = time.monotonic()
            noted: Callback[zenoh.Reply] = Callback(self._note_reply, indirect=False)
            with suppress(zenoh.ZError):  # The session has ended.
                self._session.liveliness().get(self._tokens, noted, timeout=_LOOK_S)
        return self.alive

    def answers(self, reply: zenoh.Reply) -> bool:
        """Whether a reply comes from one of them, or from zenoh in this process."""
        replier = reply.replier_id
        if replier is None:
            # zenoh's own error at a timeout has none.
            return reply.err is not None and reply.err.payload.to_bytes() == TIMEOUT
        server = str(replier.zid)
        return server in self._seen or server in map(str, self._session.info.routers_zid())

    def _note_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._note(reply.ok)

    def _note(self, token: zenoh.Sample) -> None:
        server = str(token.key_expr).rpartition("/")[2]
        if token.kind == zenoh.SampleKind.PUT:
            self._seen.add(server)
            self.alive.add(server)
        else:
            self.alive.discard(server)
            self.lost_at = time.monotonic()

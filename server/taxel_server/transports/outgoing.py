"""Gives answers over zenoh: a client that reads slowly, or not at all, holds up nobody but itself.

zenoh lets who replies wait while the client's connection is full. A client that was given more than Linux
keeps for a connection may not have read it, so a thread of its own gives it what follows, until nothing
more waits. The same happens where giving an answer has taken long.
"""

import logging
import time
from collections import deque
from collections.abc import Hashable
from threading import Condition, Thread
from typing import Final

import zenoh

from taxel.errors import RequestError
from taxel.protocol import pack_error
from taxel_server.core.policy import SLICE_S
from taxel_server.transports.zenoh_session import SEND_BUFFER

_LOG: Final = logging.getLogger(__name__)

Answer = bytes | RequestError

_SLOW_S: Final = SLICE_S
"""A client reads slowly if it takes longer to give it an answer."""

_IDLE_S: Final = 0.1
"""How long a thread waits for more, before the client counts as quick again."""

_LARGE_BYTES: Final = 2**14
"""Many answers of less fit into a connection; the first one that has to wait tells that it is full."""

_LATELY_S: Final = 0.5
"""How long a large answer counts as possibly unread."""

_LAST_S: Final = 0.2
"""Time for what zenoh still holds of the last answers to clients that read slowly."""

_MOST_BYTES: Final = 32 * 2**20
_MOST_ANSWERS: Final = 1024
"""What waits for one client at most. What goes beyond is given at once, and who gives it has to wait."""

_MOST_CLIENTS: Final = 64
"""Clients that have a thread of their own at the same time, at most."""


def reply(query: zenoh.Query, answer: Answer) -> None:
    """Answer a query and release it, so that its caller does not wait longer."""
    with query:
        try:
            if isinstance(answer, RequestError):
                query.reply_err(pack_error(answer))
            else:
                query.reply(query.key_expr, answer)
        except zenoh.ZError as error:
            _LOG.debug("a client has gone before its answer: %s", error)


class _Backlog:
    """Answers that wait for one client, and their bytes."""

    def __init__(self) -> None:
        self.waiting: deque[tuple[zenoh.Query, Answer]] = deque()
        self.bytes = 0


class Outgoing:
    """Gives answers to queries. Thread-safe."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._slow: dict[Hashable, _Backlog] = {}
        self._lately: dict[Hashable, int] = {}  # Bytes of large answers, by client.
        self._counted_from = 0.0
        self._closing = False

    def give(self, client: Hashable, query: zenoh.Query, answer: Answer) -> None:
        """Answer a query and release it: before this returns, unless the connection may be full."""
        if self._may_fill(client, _size(answer)):
            self._begin(client)
        if client in self._slow and self._wait_in_line(client, query, answer):
            return
        started = time.monotonic()
        reply(query, answer)
        if time.monotonic() - started > _SLOW_S:
            self._begin(client)

    def _may_fill(self, client: Hashable, size: int) -> bool:
        """Whether a client's connection could be full, if it has read no large answer lately."""
        if size < _LARGE_BYTES:
            return False
        with self._changed:
            now = time.monotonic()
            if now - self._counted_from > _LATELY_S:
                self._lately.clear()
                self._counted_from = now
            given = self._lately[client] = self._lately.get(client, 0) + size
        return given > SEND_BUFFER

    def close(self, patience_s: float) -> None:
        """Wait until everything is given, or for so long."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
            if not self._slow:
                return
            self._changed.wait_for(lambda: not self._slow, patience_s)
        time.sleep(_LAST_S)

    def _wait_in_line(self, client: Hashable, query: zenoh.Query, answer: Answer) -> bool:
        """Leave an answer to the client's own thread; False if it has none any more, or too much waits."""
        with self._changed:
            backlog = self._slow.get(client)
            if (
                backlog is None
                or len(backlog.waiting) >= _MOST_ANSWERS
                or backlog.bytes + _size(answer) > _MOST_BYTES
            ):
                return False
            backlog.waiting.append((query, answer))
            backlog.bytes += _size(answer)
            self._changed.notify_all()
            return True

    def _begin(self, client: Hashable) -> None:
        with self._changed:
            if client in self._slow or len(self._slow) >= _MOST_CLIENTS or self._closing:
                return
            backlog = self._slow[client] = _Backlog()
        Thread(target=self._give_all, args=(client, backlog), name="taxel-outgoing", daemon=True).start()

    def _give_all(self, client: Hashable, backlog: _Backlog) -> None:
        while (following := self._next(client, backlog)) is not None:
            try:
                reply(*following)
            except Exception:
                # Others wait behind it.
                _LOG.exception("an answer could not be given")

    def _next(self, client: Hashable, backlog: _Backlog) -> tuple[zenoh.Query, Answer] | None:
        """The next answer, once there is one; None, and the client counts as quick, if none comes."""
        with self._changed:
            self._changed.wait_for(lambda: backlog.waiting or self._closing, _IDLE_S)
            if not backlog.waiting:
                del self._slow[client]
                self._changed.notify_all()
                return None
            following = backlog.waiting.popleft()
            backlog.bytes -= _size(following[1])
            return following


def _size(answer: Answer) -> int:
    return len(answer) if isinstance(answer, bytes) else 0

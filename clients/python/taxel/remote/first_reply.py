"""Waits for the one reply to a zenoh query."""

import time
from typing import Final

import zenoh
from zenoh.handlers import Handler

from taxel.polling import give_way

_POLL_S: Final = 400e-6
"""How long a reply is asked for again and again before the thread sleeps.

A reply on the same machine usually comes within this time, and waking a sleeping thread takes a part of it.
"""

_QUICK_S: Final = 1.5 * _POLL_S
"""Where the last reply took longer, the next one is not asked for in this way."""


class FirstReply:
    """Waits for the replies to the queries of one connection. Thread-safe."""

    def __init__(self) -> None:
        self._polls = True

    def wait(self, replies: Handler[zenoh.Reply]) -> zenoh.Reply | None:
        """The first reply; None if the query ended without one."""
        began = now = time.monotonic()
        ends = began + _POLL_S if self._polls else began
        try:
            while now < ends:
                reply = replies.try_recv()
                if reply is not None:
                    return reply
                give_way()
                now = time.monotonic()
            reply = replies.recv()
        except zenoh.ZError:
            # The query has ended.
            return None
        self._polls = time.monotonic() - began < _QUICK_S
        return reply

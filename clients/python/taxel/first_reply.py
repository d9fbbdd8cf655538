"""Waits for the one reply to a zenoh query."""

import time
from typing import Final

import zenoh
from zenoh.handlers import Handler

from taxel.polling import give_way

_POLL_S: Final = 200e-6
"""How long a reply is asked for again and again before the thread sleeps.

A reply on the same machine usually comes within this time, and waking a sleeping thread takes a part of it.
"""


def first_reply(replies: Handler[zenoh.Reply]) -> zenoh.Reply | None:
    """The first reply; None if the query ended without one."""
    ends = time.monotonic() + _POLL_S
    try:
        while time.monotonic() < ends:
            reply = replies.try_recv()
            if reply is not None:
                return reply
            give_way()
        return replies.recv()
    except zenoh.ZError:
        # The query has ended.
        return None

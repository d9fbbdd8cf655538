"""Polling: whoever waits asks again and again for what is nearly there, before it sleeps."""

import math
import os
import time
from asyncio import AbstractEventLoop
from typing import Final

give_way = getattr(os, "sched_yield", lambda: time.sleep(0))
"""Lets other programs run meanwhile, such as a server on the same core."""

MOST_A_TURN_S: Final = 2e-4
"""In one turn of an event loop, replies are polled for so long at most. Its other tasks wait meanwhile."""


class PollingInLoop:
    """Whether a call may make its event loop wait: turning it takes nearly as long as a fast server does.

    Only where the last reply came quickly, and for `MOST_A_TURN_S` in one turn of the loop.

    Args:
        loop: that runs the calls.
        quick_s: a reply within so many seconds is quick.
    """

    def __init__(self, loop: AbstractEventLoop, quick_s: float) -> None:
        self._loop = loop
        self._quick_s = quick_s
        self._last_took_s = math.inf
        self._until = math.inf
        """When calls wait in the loop again; infinite where none waited outside of it since it turned."""

    @property
    def is_quick(self) -> bool:
        """Whether the last reply came quickly."""
        return self._last_took_s <= self._quick_s

    def may_poll(self, now: float) -> bool:
        """Whether this call may, at a time on the clock `time.monotonic`."""
        if not self.is_quick:
            return False
        if self._until == math.inf:
            self._until = now + MOST_A_TURN_S
            self._loop.call_soon(self._turned)
        return now <= self._until

    def note(self, took_s: float) -> None:
        """Take note of how long a reply took."""
        self._last_took_s = took_s

    def _turned(self) -> None:
        self._until = math.inf

"""Whether a server still makes progress; a service manager restarts one that does not."""

import time
from collections.abc import Callable
from threading import Lock
from typing import Final

STUCK_S: Final = 10.0
"""A server that has open requests and answers none of them for so long is not live."""


class Liveness:
    """Looks at the core's counters when asked; requests pay nothing for it. Thread-safe.

    Args:
        progress: whether the worker runs, how many requests wait, and how many were answered.
        clock: seconds that never go back.
    """

    def __init__(
        self, progress: Callable[[], tuple[bool, int, int]], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._progress = progress
        self._clock = clock
        self._lock = Lock()
        self._answered = -1
        self._since = clock()
        """When the server was last seen idle, or with more answers than before."""

    def is_live(self) -> bool:
        """Whether the worker runs, and is not stuck in one evaluation."""
        runs, waiting, answered = self._progress()
        with self._lock:
            now = self._clock()
            if not waiting or answered != self._answered:
                self._answered = answered
                self._since = now
            return runs and now - self._since <= STUCK_S

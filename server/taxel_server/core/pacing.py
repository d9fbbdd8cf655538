"""How many requests are refused at once: as many as come, as long as answers do not wait for it.

To refuse a small request costs as much processor time as to answer it. A state machine without threads
and without a clock of its own.
"""

from collections.abc import Callable
from math import inf
from typing import Final

from taxel_server.core.policy import SLICE_S

_FEWEST: Final = 2
"""Refusals in a slice that are given at once in any case."""

_FIRST: Final = 8
"""Refusals in a slice before it is known whether the worker has a core."""

_MOST: Final = 2**10
"""More are not counted: no receiver takes so many queries in a slice."""

_LOOK_S: Final = 25 * SLICE_S
"""How often it is looked whether the worker has a core. Over a few slices, chance decides."""

MOST_WAITING: Final = 0.05
"""If the worker waits for a processor for more of its time, it has no core of its own."""


class RefusalPace:
    """Few refusals in a slice while the worker waits for a processor; else ever more.

    Args:
        run_delay: seconds that the worker was ready to run and waited for a processor, since it started;
            None where the system does not tell. Then it counts as having no core of its own.
    """

    def __init__(self, run_delay: Callable[[], float | None]) -> None:
        self._run_delay = run_delay
        self._allowed = _FIRST
        self._given = 0
        self._began = 0.0
        self._looked = -inf
        self._delay_then = 0.0

    def refused(self, now: float) -> float:
        """Note a refusal.

        Args:
            now: seconds that never go back.

        Returns:
            For how many seconds nothing more should be read; 0 if the next request may be read at once.
        """
        if now - self._looked >= _LOOK_S:
            self._look(now)
        if now - self._began >= SLICE_S:
            self._began, self._given = now, 0
        self._given += 1
        return max(self._began + SLICE_S - now, 0.0) if self._given >= self._allowed else 0.0

    def _look(self, now: float) -> None:
        delay, since = self._run_delay(), now - self._looked
        if delay is None:
            self._allowed = _FEWEST
        elif since > 2 * _LOOK_S:
            # How it was without refusals says nothing of how it is with them.
            self._allowed = _FIRST
        elif delay - self._delay_then > MOST_WAITING * since:
            self._allowed = _FEWEST
        else:
            self._allowed = min(4 * self._allowed, _MOST)
        self._delay_then, self._looked = delay or 0.0, now

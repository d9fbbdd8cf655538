"""Whether a client can take its server's lane: looked up once, then ever less often if there is none."""

import time
from collections.abc import Callable
from contextlib import suppress
from threading import Lock
from typing import Any, Final

from taxel.lane.client import Lane
from taxel.lane.offer import LaneOffer, machine_identity

_PAUSE_S: Final = 1.0
"""Between two attempts to find a lane, while the server cannot be asked or has just been lost."""

_LONGEST_PAUSE_S: Final = 60.0
"""Pauses double up to this one while the server answers, but there is no lane to take."""


class LaneLookup:
    """Finds the lane of one server. Thread-safe.

    Args:
        read_metadata: the server's metadata; raises an error if they cannot be had.
        spin_us: as in `Lane`.
    """

    def __init__(self, read_metadata: Callable[[], Any], spin_us: int = 0) -> None:
        self._spin_us = spin_us
        self._read_metadata = read_metadata
        self._lock = Lock()
        self._again_at = 0.0
        self._pause_s = _PAUSE_S
        self.lane: Lane | None = None
        """The lane, as far as it is known."""

    def find(self) -> Lane | None:
        """The lane; None if the server has none, or is on another machine, or cannot be reached so."""
        with self._lock:
            if self.lane is None and time.monotonic() >= self._again_at:
                self.lane = self._looked_up()
                self._again_at = time.monotonic() + self._pause_s
            return self.lane

    def lost(self, lane: Lane, *, again: bool) -> Lane | None:
        """Give up a lane whose connection was lost.

        Args:
            lane: that was lost.
            again: connect again at once.

        Returns:
            The new lane; None if there is none now.
        """
        with self._lock:
            if self.lane is lane:
                lane.close()
                self.lane = None
                self._pause_s = _PAUSE_S
                self._again_at = time.monotonic() + self._pause_s
                if again:
                    with suppress(OSError):
                        self.lane = Lane(lane.address, self._spin_us)
            return self.lane

    def close(self) -> None:
        """Close the lane; there is none from now on."""
        with self._lock:
            self._again_at = float("inf")
            if self.lane is not None:
                self.lane.close()
                self.lane = None

    def _looked_up(self) -> Lane | None:
        pause_s, self._pause_s = self._pause_s, _PAUSE_S
        # Whatever is wrong with the lane, zenoh remains.
        with suppress(Exception):
            offer = LaneOffer.read(self._read_metadata())
            # A look costs a query, which a window would wait for each time.
            self._pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
            if offer is not None and offer.machine == machine_identity():
                return Lane(offer.address, self._spin_us)
        return None

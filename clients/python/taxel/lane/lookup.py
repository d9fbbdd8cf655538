"""Whether a client has its server's lane, and when it looks for one: ever less often if there is none."""

import time
from threading import Lock
from typing import Final, Generic, Protocol, TypeVar

_RETRY_S: Final = 0.25
"""Between two attempts to find a lane, while the server cannot be asked or has just been lost."""

_FIRST_PAUSE_S: Final = 2.0
_LONGEST_PAUSE_S: Final = 60.0
"""While the server answers, but there is no lane to take, pauses double from the first to the longest."""


class OpenLane(Protocol):
    """The client's end of a lane."""

    address: str
    extensions: tuple[str, ...]

    def close(self) -> None:
        """Close its connections."""


LaneT = TypeVar("LaneT", bound=OpenLane)


class LaneLookup(Generic[LaneT]):
    """Remembers the lane of one server, and says who may look for it. Thread-safe; it waits for nothing.

    Attributes:
        lane: the lane, as far as it is known.
        looking: whether somebody looks for one now.
    """

    def __init__(self) -> None:
        self.lane: LaneT | None = None
        self.looking = False
        self._lock = Lock()
        self._again_at = 0.0
        self._pause_s = _FIRST_PAUSE_S
        self._closed = False

    def begin(self) -> bool:
        """Whether the caller is to look for a lane now; then it must call `end`."""
        with self._lock:
            if self.lane or self.looking or self._closed or time.monotonic() < self._again_at:
                return False
            self.looking = True
            return True

    def lost(self, lane: LaneT) -> bool:
        """Give up a lane whose connection was lost.

        Returns:
            Whether the caller is to open it again; then it must call `end`. Else somebody else does.
        """
        with self._lock:
            if self.lane is not lane:
                return False
            lane.close()
            self.lane = None
            self.looking = True
            return True

    def end(self, lane: LaneT | None, *, there_is_none: bool = False) -> None:
        """What was found.

        Args:
            lane: the lane; None if it was not found.
            there_is_none: the server has answered, and has none that this client can take.
        """
        with self._lock:
            self.looking = False
            self._again_at = time.monotonic() + (self._pause_s if there_is_none else _RETRY_S)
            self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S) if there_is_none else _FIRST_PAUSE_S
            if lane is not None and self._closed:
                lane.close()
            else:
                self.lane = lane

    def close(self) -> None:
        """Close the lane; there is none from now on."""
        with self._lock:
            self._closed = True
            if self.lane is not None:
                self.lane.close()
                self.lane = None

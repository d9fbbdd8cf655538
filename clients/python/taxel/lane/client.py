"""The client's end of a lane: a pool of connections, so that each call has one to itself."""

import time
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.lane.connection import SMALL, ConnectionLost, LaneConnection
from taxel.lane.frames import ReplyHead, read_counts
from taxel.lane.repeated_request import RepeatedRequest

_MOST_IDLE: Final = 64
"""Connections that are kept for later calls."""


class Lane:
    """Connections to one server's lane. Thread-safe.

    Args:
        address: `unix:PATH` or `tcp:HOST:PORT`.
        spin_us: microseconds that a reply is asked for again and again before the thread sleeps; at
            least `POLL_US`.
        extensions: what the server understands beyond requests.

    Attributes:
        idle: connections that no call uses now.

    Raises:
        ValueError: that is no address of a lane.
        OSError: nobody listens there.
    """

    def __init__(self, address: str, spin_us: int = 0, extensions: tuple[str, ...] = ()) -> None:
        self.address = address
        self.extensions = extensions
        self.spin_us = spin_us
        self.idle = [LaneConnection(address, spin_us)]
        self._closed = False

    def infer(
        self,
        path: str,
        windows: NDArray[np.float32],
        timeout_s: float,
        wait_s: float,
        *,
        spread: bool,
        traceparent: str | None = None,
    ) -> tuple[ReplyHead, list[NDArray[np.float32]]]:
        """Ask for predictions.

        Args:
            path: of the request, such as `v2/models/xgb/infer`.
            windows: (n, f) float32, C-contiguous.
            timeout_s: the deadline that the server is told.
            wait_s: how long an answer is waited for.
            spread: ask for the spread, too.
            traceparent: of the W3C, for a server that takes it.

        Returns:
            The head of the reply, and the counts (n, 21), followed by the spread if it was asked for.

        Raises:
            RequestError: the server's typed error, or `DeadlineExceeded`.
            ConnectionLost: the connection ended; a new one may do better.
            OSError: nobody listens any more.
        """
        connection = self._taken()
        try:
            # A small request is sent at once.
            began = time.monotonic() if windows.nbytes > SMALL else None
            connection.send(path, windows, timeout_s, wait_s, spread=spread, traceparent=traceparent)
            head, content = connection.receive(wait_s, began)
        except BaseException as error:
            raise _closed(connection, error) from None
        self._give_back(connection)
        return head, read_counts(content, head)

    def repeat(self, request: RepeatedRequest, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The counts (n, 21) of windows that the request takes; errors as in `infer`."""
        connection = self._taken()
        try:
            counts = connection.repeat(request, windows)
            if counts is None:
                head, content = connection.receive(request.wait_s)
        except BaseException as error:
            raise _closed(connection, error) from None
        self._give_back(connection)
        return read_counts(content, head)[0] if counts is None else counts

    def _taken(self) -> LaneConnection:
        try:
            return self.idle.pop()
        except IndexError:
            return LaneConnection(self.address, self.spin_us)

    def _give_back(self, connection: LaneConnection) -> None:
        if len(self.idle) < _MOST_IDLE and not self._closed:
            self.idle.append(connection)
        else:
            connection.close()

    def close(self) -> None:
        """Close all connections; those in use are closed after their calls."""
        self._closed = True
        while self.idle:
            self.idle.pop().close()


def _closed(connection: LaneConnection, error: BaseException) -> BaseException:
    """The error of a call, whose connection is closed: a late reply must not answer the next call."""
    if isinstance(error, ConnectionLost):
        error.new = not connection.has_answered
    connection.close()
    return error

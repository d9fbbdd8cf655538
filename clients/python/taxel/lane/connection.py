"""One connection of a client to a lane: requests go out, and their replies come in any order."""

import math
import select
import socket
import sys
import time
from struct import Struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import DeadlineExceeded, Internal
from taxel.lane.frames import HEAD_BYTES, ID_AT, ReplyHead, pack_request_head, read_reply_head
from taxel.lane.offer import connect_to
from taxel.lane.repeated_request import RepeatedRequest
from taxel.polling import give_way

_KEPT_HEADS: Final = 64
_RECEIVE_BYTES: Final = 65_536
SMALL: Final = 65_536
"""A request with so many bytes of windows is put together before it is sent."""

_LEAST_BYTES: Final = 4096
"""Room for a reply, where an error may come in place of few counts."""

POLL_US: Final = 100
"""A reply is asked for again and again for so long before the thread sleeps.

The reply to a single window usually comes within this time, and waking a sleeping thread on another core
takes nearly as long. Where the last reply took twice as long, the next one is not asked for in this way.
"""

_TIMEVAL: Final = Struct("ll") if sys.platform == "linux" else None
"""How the kernel is told a timeout; elsewhere Python keeps it, which takes a system call more."""

_DONT_WAIT: Final = getattr(socket, "MSG_DONTWAIT", None)
"""Windows has no such flag: a client that sends much before it reads may be closed there."""


class ConnectionLost(Exception):
    """The server closed the connection, or broke the lane's rules, before the answer was there.

    Attributes:
        new: whether nothing was ever answered on this connection, so that another one may do no better.
    """

    new = False


class LaneConnection:
    """One connection; `receive` gives the replies to what was sent, in any order.

    The arguments and errors are those of `taxel.lane.client.Lane`.
    """

    def __init__(self, address: str, spin_us: int = 0) -> None:
        self.address = address
        self.socket = connect_to(address)
        self._poll_s = max(spin_us, POLL_US) / 1e6
        self._quick_s = math.inf if spin_us else 2 * self._poll_s
        self._polls = _DONT_WAIT is not None
        if _DONT_WAIT is not None:
            self._readable = select.poll()
            self._readable.register(self.socket, select.POLLIN)
        self._wait_s = math.inf
        self._heads: dict[tuple[str, tuple[int, ...], float, bool], tuple[bytes, bytes]] = {}
        self._last_id = 0
        self._in_flight = 0
        self.has_answered = False
        self._received = b""
        """What came behind the last reply."""

    def send(
        self,
        path: str,
        windows: NDArray[np.float32],
        timeout_s: float,
        wait_s: float,
        *,
        spread: bool,
        traceparent: str | None = None,
    ) -> int:
        """Send a request; the arguments are those of `Lane.infer`. The reply repeats the id returned.

        Raises:
            DeadlineExceeded: the server does not read.
            ConnectionLost: it has gone.
        """
        self._last_id = number = self._last_id % 0xFFFFFFFF + 1
        before, after = self._head(path, windows.shape, timeout_s, spread, traceparent)
        if sys.byteorder == "big":
            windows = windows.astype("<f4")
        if wait_s != self._wait_s:
            self._set_wait(wait_s)
        head = b"".join((before, number.to_bytes(4, "little"), after))
        try:
            if windows.nbytes > SMALL:
                ends = time.monotonic() + wait_s
                self._send_all(head, ends)
                self._send_all(windows.data.cast("B"), ends)
            elif self._in_flight:
                self._send_all(head + windows.data, time.monotonic() + wait_s)
            else:
                self.socket.sendall(head + windows.data)
        except (BlockingIOError, TimeoutError):
            raise self._late(wait_s) from None
        except OSError as error:
            raise ConnectionLost(str(error)) from None
        self._in_flight += 1
        return number

    def repeat(self, request: RepeatedRequest, windows: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """Send windows as one more request of its kind, and wait; call it where nothing else is in flight.

        Returns:
            The counts (n, 21); None if the reply is another one, or not all of it: `receive` then gives it.

        Raises:
            DeadlineExceeded: the reply does not come in time.
            ConnectionLost: the server has gone.
        """
        wait_s = request.wait_s
        if wait_s != self._wait_s:
            self._set_wait(wait_s)
        try:
            self.socket.sendall(request.head + windows.tobytes())
        except (BlockingIOError, TimeoutError):
            raise self._late(wait_s) from None
        except OSError as error:
            raise ConnectionLost(str(error)) from None
        ends = time.monotonic() + wait_s
        received = self._some(wait_s, ends, max(request.reply_size, _LEAST_BYTES))
        counts = request.counts_in(received)
        if counts is None:
            self._received = received
            self._in_flight += 1
        else:
            self.has_answered = True
        return counts

    def receive(self, wait_s: float, began: float | None = None) -> tuple[ReplyHead, bytes | bytearray]:
        """The next reply, and its content.

        Args:
            wait_s: how long it is waited for.
            began: from when on, on `time.monotonic`; None: from now on.

        Raises:
            DeadlineExceeded: it does not come in time.
            ConnectionLost: the server has gone.
        """
        ends = (time.monotonic() if began is None else began) + wait_s
        received: bytes | bytearray = self._received or self._some(wait_s, ends)
        if len(received) < HEAD_BYTES:
            received = self._up_to(HEAD_BYTES, received, wait_s, ends)
        try:
            head = read_reply_head(received)
        except Internal as error:
            raise ConnectionLost(str(error)) from None
        if len(received) < head.size:
            received = self._up_to(head.size, received, wait_s, ends)
        self._received = bytes(received[head.size :]) if len(received) > head.size else b""
        self._in_flight -= 1
        self.has_answered = True
        return head, received[HEAD_BYTES : head.size]

    def close(self) -> None:
        """Close the connection."""
        self.socket.close()

    def _head(
        self,
        path: str,
        shape: tuple[int, ...],
        timeout_s: float,
        spread: bool,
        traceparent: str | None,
    ) -> tuple[bytes, bytes]:
        """The bytes before and after the id: a control loop sends the same ones each time."""
        what = (path, shape, timeout_s, spread)
        known = self._heads.get(what) if traceparent is None else None
        if known is None:
            head = pack_request_head(
                path, 0, shape, timeout_s * 1e3, spread=spread, traceparent=traceparent
            )
            known = head[:ID_AT], head[ID_AT + 4 :]
            if len(self._heads) < _KEPT_HEADS and traceparent is None:
                self._heads[what] = known
        return known

    def _send_all(self, data: bytes | memoryview, ends: float) -> None:
        """Send by a deadline, and take replies meanwhile: without that the server would read no more.

        Raises:
            BlockingIOError: the server has not read all of it in time.
        """
        if _DONT_WAIT is None:
            self.socket.sendall(data)
            return
        unsent, waiting = memoryview(data), select.poll()
        waiting.register(self.socket, select.POLLOUT | (select.POLLIN if self._in_flight else 0))
        while unsent:
            try:
                unsent = unsent[self.socket.send(unsent, _DONT_WAIT) :]
            except BlockingIOError:
                left = ends - time.monotonic()
                happened = waiting.poll(None if left == math.inf else left * 1e3) if left > 0 else []
                if not happened:
                    raise
                if happened[0][1] & select.POLLIN:
                    self._received += self.socket.recv(_RECEIVE_BYTES)

    def _some(self, wait_s: float, ends: float, most: int = _RECEIVE_BYTES) -> bytes:
        began = time.monotonic()
        try:
            received = self._polled(began) if self._polls else None
            if received is None:
                received = self._arrived(most, ends)
                self._polls = _DONT_WAIT is not None and time.monotonic() - began < self._quick_s
        except (BlockingIOError, TimeoutError):
            raise self._late(wait_s) from None
        except OSError as error:
            raise ConnectionLost(str(error)) from None
        if not received:
            raise ConnectionLost("the server closed the connection")
        return received

    def _polled(self, began: float) -> bytes | None:
        """What arrives while this asks again and again; None if nothing does."""
        assert _DONT_WAIT is not None
        ends = began + self._poll_s
        while time.monotonic() < ends:
            try:
                return self.socket.recv(_RECEIVE_BYTES, _DONT_WAIT)
            except BlockingIOError:
                give_way()
        return None

    def _arrived(self, most: int, ends: float) -> bytes:
        """What arrives until then. A signal begins no wait anew, as it would in `recv`.

        Raises:
            BlockingIOError: nothing does.
        """
        self._wait_to_receive(ends)
        return self.socket.recv(most, _DONT_WAIT or 0)

    def _wait_to_receive(self, ends: float) -> None:
        """Wait until then; without the flag not to wait, let the next call wait, at least for a moment."""
        left = ends - time.monotonic()
        if _DONT_WAIT is not None:
            self._readable.poll(None if left == math.inf else max(left, 0.0) * 1e3)
        elif left < math.inf:
            self._set_wait(max(left, 1e-6))

    def _up_to(self, size: int, received: bytes | bytearray, wait_s: float, ends: float) -> bytearray:
        """At least `size` bytes by a time, of which the first were received already."""
        whole = bytearray(size)
        whole[: len(received)] = received
        missing = memoryview(whole)[len(received) :]
        while missing:
            try:
                self._wait_to_receive(ends)
                count = self.socket.recv_into(missing, 0, _DONT_WAIT or 0)
            except (BlockingIOError, TimeoutError):
                raise self._late(wait_s) from None
            except OSError as error:
                raise ConnectionLost(str(error)) from None
            if not count:
                raise ConnectionLost("the server closed the connection")
            missing = missing[count:]
        return whole

    def _set_wait(self, wait_s: float) -> None:
        self._wait_s = wait_s
        if _TIMEVAL is None:
            self.socket.settimeout(wait_s)
            return
        fraction, whole = math.modf(max(wait_s, 1e-6))
        value = _TIMEVAL.pack(int(whole), int(fraction * 1e6))
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, value)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, value)

    def _late(self, wait_s: float) -> DeadlineExceeded:
        return DeadlineExceeded(f"{self.address}: no answer within {wait_s:g} s")

"""The client's end of a lane in an event loop: one connection that all calls share."""

import asyncio
import math
import socket
import sys
import time
from asyncio import TimerHandle
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.errors import DeadlineExceeded, Internal
from taxel.lane.connection import POLL_US, ConnectionLost
from taxel.lane.frames import (
    HEAD_BYTES,
    ID_AT,
    ID_END,
    PREDICTIONS,
    ReplyHead,
    pack_cancel,
    pack_request_head,
    read_counts,
    read_reply_head,
)
from taxel.lane.offer import UNIX, of_this_user, parse_address
from taxel.lane.outgoing import Outgoing
from taxel.lane.prompt_future import PromptFuture
from taxel.lane.repeated_request import RepeatedRequest
from taxel.polling import PollingInLoop, give_way
from taxel.protocol import CANCEL

_CONNECT_S: Final = 1.0
_KEPT_HEADS: Final = 64
_SMALL_BYTES: Final = 8192
"""Room for the reply to a request that is repeated."""

_BUFFER_BYTES: Final = 65_536

_QUICK_S: Final = 2e-4
"""Where the last reply took longer, the next one is not polled for."""

Reply = tuple[ReplyHead, bytes | bytearray]
"""A reply's head, and what follows it."""

Content = Reply | NDArray[np.float32]
"""A reply, or its counts (n, 21) if that was enough."""


class AsyncLane:
    """A connection to a server's lane; made by `open`. It belongs to the loop that it was opened in.

    Replies come in any order, and find their calls by the request's id. One whose call is over is skipped.
    """

    def __init__(self, address: str, extensions: tuple[str, ...], connection: socket.socket) -> None:
        self.address = address
        self.extensions = extensions
        self._cancels = CANCEL in extensions
        self._loop = asyncio.get_running_loop()
        self._socket = connection
        self._outgoing = Outgoing(self._loop, connection, self._end)
        self._calls: dict[int, tuple[int, float, PromptFuture[Content], RepeatedRequest | None]] = {}
        """By its id: how many windows a call in flight sent, when it ends, what it waits for, its kind."""
        self._last_id = 0
        self._heads: dict[tuple[str, tuple[int, ...], float, bool], tuple[bytes, bytes]] = {}
        self._buffer = bytearray(_BUFFER_BYTES)
        self._view = memoryview(self._buffer)
        self._filled = 0
        self._large: tuple[ReplyHead, bytearray] | None = None
        """A reply that is larger than the buffer, with its content."""
        self._missing = self._view[:0]
        """The part of this content that is still to come."""
        self._to_skip = 0
        """Bytes of a reply that nobody waits for, still to come."""
        self._timer: TimerHandle | None = None
        self._timer_at = math.inf
        self._polling = PollingInLoop(self._loop, _QUICK_S)
        self._has_answered = False
        self._lost: str | None = None
        try:
            self._loop.add_reader(connection, self._read)
        except NotImplementedError:
            raise OSError(f"{address}: this event loop watches no sockets") from None

    @classmethod
    async def open(cls, address: str, extensions: tuple[str, ...] = ()) -> Self:
        """Connect.

        Args:
            address: `unix:PATH` or `tcp:HOST:PORT`.
            extensions: what the server understands beyond requests, as it tells.

        Raises:
            ValueError: that is no address of a lane.
            OSError: nobody listens there, or the listener belongs to another user.
        """
        place = parse_address(address)
        loop = asyncio.get_running_loop()
        if isinstance(place, tuple):
            connection = socket.socket(socket.AF_INET6 if ":" in place[0] else socket.AF_INET)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        elif UNIX:
            connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        else:
            raise OSError(f"{address}: this platform has no unix sockets")
        try:
            connection.setblocking(False)
            async with asyncio.timeout(_CONNECT_S):
                await loop.sock_connect(connection, place if isinstance(place, tuple) else str(place))
            if not isinstance(place, tuple) and not of_this_user(connection):
                raise PermissionError(f"{address}: another user listens there")
            return cls(address, extensions, connection)
        except BaseException:
            connection.close()
            raise

    @property
    def calls_in_flight(self) -> int:
        """Calls that wait for their replies."""
        return len(self._calls)

    async def infer(
        self,
        path: str,
        windows: NDArray[np.float32],
        timeout_s: float,
        wait_s: float,
        *,
        spread: bool,
        traceparent: str | None = None,
    ) -> tuple[ReplyHead, list[NDArray[np.float32]]]:
        """Ask for predictions; arguments, result and errors are those of `Lane.infer`.

        A call that is cancelled is forgotten at once, and the server is told, so that it drops the request.
        """
        ends = time.monotonic() + wait_s
        if not self._outgoing.may_send.is_set():
            await self._until_writable(wait_s)
        if self._lost is not None:
            raise self._connection_lost(self._lost)
        self._last_id = number = self._last_id % 0xFFFFFFFF + 1
        before, after = self._head(path, windows.shape, timeout_s, spread, traceparent)
        data = windows.data if sys.byteorder == "little" else windows.astype("<f4").data
        request = b"".join((before, number.to_bytes(4, "little"), after, data))
        self._outgoing.send(request)
        content = await self._reply(number, len(windows), ends, wait_s)
        assert isinstance(content, tuple)
        return content[0], read_counts(content[1], content[0])

    async def repeat(self, request: RepeatedRequest, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The counts (n, 21) of windows that the request takes; errors as in `infer`."""
        if not self._outgoing.may_send.is_set():
            await self._until_writable(request.wait_s)
        if self._lost is not None:
            raise self._connection_lost(self._lost)
        self._last_id = number = self._last_id % 0xFFFFFFFF + 1
        self._outgoing.send(
            b"".join((request.before, number.to_bytes(4, "little"), request.after, windows.tobytes()))
        )
        # The server works already.
        began = time.monotonic()
        received = self._received_at_once(began)
        if (
            received
            and int.from_bytes(received[ID_AT:ID_END], "little") == number
            and (counts := request.counts_for(received)) is not None
        ):
            self._has_answered = True
            self._polling.note(time.monotonic() - began)
            return counts
        ends = began + request.wait_s
        content = await self._reply(number, request.shape[0], ends, request.wait_s, request, received)
        self._polling.note(time.monotonic() - began)
        return content if isinstance(content, np.ndarray) else read_counts(content[1], content[0])[0]

    async def _reply(
        self,
        number: int,
        rows: int,
        ends: float,
        wait_s: float,
        request: RepeatedRequest | None = None,
        received: bytes | None = None,
    ) -> Content:
        """The reply to a request that was sent.

        Args:
            received: what arrived already and nobody has looked at.
        """
        if self._lost is not None:
            raise self._connection_lost(self._lost)
        reply: PromptFuture[Content] = PromptFuture(loop=self._loop)
        self._calls[number] = rows, ends, reply, request
        if ends < self._timer_at:
            self._wake_at(ends)
        if received is not None:
            self._take(received)
        try:
            return await reply
        except (asyncio.CancelledError, TimeoutError) as error:
            raise self._given_up(number, error, wait_s) from None
        finally:
            del self._calls[number]

    def _received_at_once(self, now: float) -> bytes | None:
        """What arrives if the loop is made to wait; None where it may not be, or where nothing comes."""
        if self._calls or self._filled or self._to_skip or not self._polling.may_poll(now):
            return None
        ends = now + POLL_US / 1e6
        while time.monotonic() < ends:
            try:
                return self._socket.recv(_SMALL_BYTES)
            except (BlockingIOError, InterruptedError):
                give_way()
            except OSError:  # The loop sees a lost connection, too.
                break
        return None

    def _given_up(self, number: int, error: BaseException, wait_s: float) -> BaseException:
        """The error of a call that waits no longer; the server is told."""
        if self._cancels and self._lost is None:
            self._outgoing.send(pack_cancel(number))
        if isinstance(error, asyncio.CancelledError):
            return error
        return DeadlineExceeded(f"{self.address}: no answer within {wait_s:g} s")

    def close(self) -> None:
        """Close the connection; calls in flight end with `ConnectionLost`."""
        self._end("it was closed")

    def _read(self) -> None:
        """Take what has arrived; the loop calls it."""
        try:
            if self._filled or self._to_skip or self._large is not None:
                size = self._socket.recv_into(self._missing or self._view[self._filled :])
            else:
                self._take(self._socket.recv(_SMALL_BYTES))
                return
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._end(str(error))
            return
        self._look_at(size)

    def _take(self, data: bytes) -> None:
        """Look at what arrived where nothing was awaited in part."""
        if not self._is_repeated(data):
            self._buffer[: len(data)] = data
            self._look_at(len(data))

    def _look_at(self, size: int) -> None:
        """Settle the calls whose replies are whole with the bytes that have arrived; none are the end."""
        if not size:
            self._end("the server closed the connection")
            return
        replies: list[Reply] = []
        wrong = None
        if self._large is None:
            try:
                self._take_replies(self._filled + size, replies)
            except Internal as error:
                wrong = str(error)
        else:
            self._missing = self._missing[size:]
            if not self._missing:
                replies.append(self._large)
                self._large = None
        # Last: tasks that go on may send more, or close this.
        for head, content in replies:
            self._settle(head, content)
        if wrong is not None:
            self._end(wrong)

    def _is_repeated(self, data: bytes) -> bool:
        """Settle the call of a control loop, if that is all that has arrived."""
        call = self._calls.get(int.from_bytes(data[ID_AT:ID_END], "little"))
        if call is None or call[3] is None or (counts := call[3].counts_for(data)) is None:
            return False
        self._has_answered = True
        call[2].settle(counts)
        return True

    def _take_replies(self, end: int, replies: list[Reply]) -> None:
        """Add the replies in the buffer that somebody waits for; what is there of the next one is kept."""
        at = min(self._to_skip, end)
        self._to_skip -= at
        while end - at >= HEAD_BYTES:
            head = read_reply_head(self._buffer if not at else self._buffer[at : at + HEAD_BYTES])
            call = self._calls.get(head.id)
            if call is not None and head.kind == PREDICTIONS and head.rows != call[0]:
                raise Internal(f"the server answered {head.rows} rows to {call[0]} windows")
            start, stop = at + HEAD_BYTES, at + head.size
            if stop <= end:
                if call is not None:
                    replies.append((head, bytes(self._view[start:stop])))
            elif call is None:
                self._to_skip = stop - end
                stop = end
            elif head.size > _BUFFER_BYTES:
                content = bytearray(head.size - HEAD_BYTES)
                content[: end - start] = self._view[start:end]
                self._large = head, content
                self._missing = memoryview(content)[end - start :]
                stop = end
            else:
                break
            at = stop
        self._filled = end - at
        if self._filled and at:
            self._buffer[: self._filled] = self._buffer[at:end]

    def _settle(self, head: ReplyHead, content: bytes | bytearray) -> None:
        self._has_answered = True
        call = self._calls.get(head.id)
        if call is not None:
            call[2].settle((head, content))

    def _head(
        self,
        path: str,
        shape: tuple[int, ...],
        timeout_s: float,
        spread: bool,
        traceparent: str | None,
    ) -> tuple[bytes, bytes]:
        """The bytes before and after the id."""
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

    async def _until_writable(self, wait_s: float) -> None:
        try:
            async with asyncio.timeout(wait_s):
                await self._outgoing.may_send.wait()
        except TimeoutError:
            raise DeadlineExceeded(f"{self.address}: the server did not read within {wait_s:g} s") from None

    def _wake_at(self, when: float) -> None:
        """One timer serves all calls: it rings when the first of them may be over."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer_at = when
        self._timer = self._loop.call_later(max(when - time.monotonic(), 0), self._ring)

    def _ring(self) -> None:
        now, first = time.monotonic(), math.inf
        for _, ends, reply, _ in self._calls.values():
            if ends > now:
                first = min(first, ends)
            elif not reply.done():
                reply.set_exception(TimeoutError())
        self._timer, self._timer_at = None, math.inf
        if first < math.inf:
            self._wake_at(first)

    def _end(self, reason: str) -> None:
        """Close the connection: no reply will come any more."""
        if self._lost is not None:
            return
        self._lost = reason
        if self._timer is not None:
            self._timer.cancel()
        self._loop.remove_reader(self._socket)
        self._outgoing.end()
        self._socket.close()
        for _, _, reply, _ in self._calls.values():
            if not reply.done():
                reply.set_exception(self._connection_lost(reason))

    def _connection_lost(self, reason: str) -> ConnectionLost:
        lost = ConnectionLost(reason)
        lost.new = not self._has_answered
        return lost

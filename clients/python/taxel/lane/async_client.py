"""The client's end of a lane in an event loop: one connection that all calls share."""

import asyncio
import math
import socket
import sys
import time
from asyncio import Future, TimerHandle, Transport
from typing import Final, Self, cast

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.errors import DeadlineExceeded, Internal
from taxel.lane.client import ConnectionLost
from taxel.lane.frames import (
    HEAD_BYTES,
    ID_AT,
    PREDICTIONS,
    ReplyHead,
    pack_cancel,
    pack_request_head,
    read_counts,
    read_reply_head,
)
from taxel.lane.offer import UNIX, of_this_user, parse_address
from taxel.protocol import CANCEL

_CONNECT_S: Final = 1.0
_KEPT_HEADS: Final = 64
_BUFFER_BYTES: Final = 65_536


_Reply = Future[tuple[ReplyHead, bytes | bytearray]]


class AsyncLane(asyncio.BufferedProtocol):
    """A connection to a server's lane; made by `open`. It belongs to the loop that it was opened in.

    Replies come in any order, and find their calls by the request's id. One whose call is over is skipped.
    """

    def __init__(self, address: str, extensions: tuple[str, ...] = ()) -> None:
        self.address = address
        self.extensions = extensions
        self._cancels = CANCEL in extensions
        self._loop = asyncio.get_running_loop()
        self._calls: dict[int, tuple[int, float, _Reply]] = {}
        """How many windows a call in flight sent, when it ends, and what it waits for, by its id."""
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
        self._may_write = asyncio.Event()
        self._may_write.set()
        self._has_answered = False
        self._lost: str | None = None

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
            _, lane = await loop.create_connection(lambda: cls(address, extensions), sock=connection)
        except BaseException:
            connection.close()
            raise
        return lane

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
        if not self._may_write.is_set():
            await self._until_writable(wait_s)
        if self._lost is not None:
            raise self._connection_lost(self._lost)
        self._last_id = number = self._last_id % 0xFFFFFFFF + 1
        before, after = self._head(path, windows.shape, timeout_s, spread, traceparent)
        data = windows.data if sys.byteorder == "little" else windows.astype("<f4").data
        self._transport.write(b"".join((before, number.to_bytes(4, "little"), after, data)))
        if ends < self._timer_at:
            self._wake_at(ends)
        reply: _Reply = self._loop.create_future()
        self._calls[number] = len(windows), ends, reply
        try:
            head, content = await reply
        except asyncio.CancelledError:
            self._give_up(number)
            raise
        except TimeoutError:
            self._give_up(number)
            raise DeadlineExceeded(f"{self.address}: no answer within {wait_s:g} s") from None
        finally:
            del self._calls[number]
        return head, read_counts(content, head)

    def _give_up(self, number: int) -> None:
        if self._cancels and self._lost is None:
            self._transport.write(pack_cancel(number))

    def close(self) -> None:
        """Close the connection; calls in flight end with `ConnectionLost`."""
        self._end("it was closed")
        self._transport.abort()

    @override
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("Transport", transport)

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self._end(str(exc or "the server closed the connection"))

    @override
    def pause_writing(self) -> None:
        self._may_write.clear()

    @override
    def resume_writing(self) -> None:
        self._may_write.set()

    @override
    def get_buffer(self, sizehint: int) -> memoryview:
        return self._missing or self._view[self._filled :]

    @override
    def buffer_updated(self, nbytes: int) -> None:
        try:
            if self._large is not None:
                self._missing = self._missing[nbytes:]
                if not self._missing:
                    large, self._large = self._large, None
                    self._settle(*large)
            else:
                self._take_replies(self._filled + nbytes)
        except Internal as error:
            self._end(str(error))
            self._transport.abort()

    def _take_replies(self, end: int) -> None:
        """Hand out the replies in the buffer, and keep what is there of the next one."""
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
                    self._settle(head, bytes(self._view[start:stop]))
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
        if call is not None and not call[2].done():
            call[2].set_result((head, content))

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
                await self._may_write.wait()
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
        for _, ends, reply in self._calls.values():
            if ends > now:
                first = min(first, ends)
            elif not reply.done():
                reply.set_exception(TimeoutError())
        self._timer, self._timer_at = None, math.inf
        if first < math.inf:
            self._wake_at(first)

    def _end(self, reason: str) -> None:
        """No reply will come any more."""
        if self._lost is None:
            self._lost = reason
        if self._timer is not None:
            self._timer.cancel()
        self._may_write.set()
        for _, _, reply in self._calls.values():
            if not reply.done():
                reply.set_exception(self._connection_lost(reason))

    def _connection_lost(self, reason: str) -> ConnectionLost:
        lost = ConnectionLost(reason)
        lost.new = not self._has_answered
        return lost

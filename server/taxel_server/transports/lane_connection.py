"""One client of the lane: what it sends becomes jobs, and their answers go back, without ever blocking.

The lane's thread reads. Whoever has an answer sends it, as far as the client takes it at once; what is
left waits in the outbox for the lane's thread. Nothing is read from a client whose outbox is not empty.
"""

import logging
import socket
import time
from collections import deque
from collections.abc import Callable
from threading import Lock
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.errors import Internal, InvalidArgument, NotFound, RequestError, ResourceExhausted
from taxel.lane.frames import HEAD_BYTES, RequestHead, pack_reply, read_request_head
from taxel.protocol import InferRequest, InferResponse, checked_timeout_ms
from taxel_server.core.core import Core
from taxel_server.core.jobs import Job, check_shape
from taxel_server.engine import LoadedModel

_LOG: Final = logging.getLogger(__name__)

_RECEIVE_BYTES: Final = 65_536


class Budget:
    """Bytes that all clients together may make the lane hold. Thread-safe."""

    def __init__(self, limit: int) -> None:
        self._left = limit
        self._lock = Lock()

    def take(self, size: int) -> bool:
        """Reserve bytes; False if there are not so many left."""
        with self._lock:
            if size > self._left:
                return False
            self._left -= size
            return True

    def give(self, size: int) -> None:
        """Give reserved bytes back."""
        with self._lock:
            self._left += size


class LaneJob(Job):
    """A request of the lane, with its windows (n, f)."""

    def __init__(
        self,
        connection: "LaneConnection",
        model: LoadedModel,
        head: RequestHead,
        windows: NDArray[np.float32],
    ) -> None:
        super().__init__(model, head.rows)
        self._connection = connection
        self._head = head
        self._windows = windows

    @override
    def decode(self) -> InferRequest:
        timeout_ms = checked_timeout_ms(self._head.timeout_ms) if self._head.timeout_ms else None
        return InferRequest(self._windows, None, timeout_ms, self._head.spread)

    @override
    def answer(self, result: InferResponse | RequestError) -> None:
        self._connection.send(pack_reply(self._head.id, result))


class _Arriving:
    """A request of which a part has not arrived yet."""

    def __init__(self, head: RequestHead, model: LoadedModel) -> None:
        self.head = head
        self.model = model
        self.windows = np.empty((head.rows, head.columns), "<f4")
        self.missing = self.windows.data.cast("B")

    def fill(self, data: memoryview) -> None:
        """Put bytes that arrived into their place."""
        self.missing[: len(data)] = data
        self.missing = self.missing[len(data) :]


class LaneConnection:
    """Reads requests and sends replies; all methods but `send` belong to the lane's thread.

    Args:
        client: its socket, which does not block.
        core: what answers.
        budget: of requests in part and of replies that wait.
        notify: tells the lane's thread that the outbox is no longer empty, or that the client has gone.
    """

    def __init__(
        self,
        client: socket.socket,
        core: Core,
        budget: Budget,
        notify: Callable[["LaneConnection"], None],
    ) -> None:
        self.socket = client
        self.progressed_at = 0.0
        """When bytes last moved while a request or a reply was under way."""
        self._core = core
        self._budget = budget
        self._notify = notify
        self._rest = b""
        """The start of a request whose head or path is not there yet."""
        self._arriving: _Arriving | None = None
        self._to_skip = 0
        """Bytes of a refused request that are still to come."""
        self._outbox: deque[memoryview] = deque()
        self._closed = False
        self._lock = Lock()
        """Of the outbox and the socket's sending side."""

    @property
    def has_outbox(self) -> bool:
        """Whether replies wait for the client to read."""
        return bool(self._outbox)

    @property
    def is_under_way(self) -> bool:
        """Whether the client owes bytes, or does not read its replies."""
        return bool(self._rest or self._arriving or self._to_skip or self._outbox)

    def read(self, alone: bool) -> bool:
        """Take what has arrived and pass whole requests on; False if the client has gone or must go.

        Args:
            alone: no other client has sent anything, so that a single window may be answered at once.
        """
        self.progressed_at = time.monotonic()
        if self._arriving is not None:
            return self._read_into(self._arriving)
        data = self.socket.recv(_RECEIVE_BYTES)
        if not data:
            return False
        if self._to_skip:
            skipped = min(self._to_skip, len(data))
            self._to_skip -= skipped
            data = data[skipped:]
        if self._rest:
            data = self._rest + data
            self._rest = b""
        try:
            self._take_requests(data, alone)
        except InvalidArgument as error:
            # Where the next request starts is not known any more.
            self.send(pack_reply(0, error))
            return False
        return True

    def flush(self) -> None:
        """Send what the client takes now.

        Raises:
            OSError: the client has gone.
        """
        with self._lock:
            while self._outbox:
                first = self._outbox[0]
                try:
                    sent = self.socket.send(first)
                except BlockingIOError:
                    return
                self.progressed_at = time.monotonic()
                self._budget.give(sent)
                if sent < len(first):
                    self._outbox[0] = first[sent:]
                    return
                self._outbox.popleft()

    def send(self, reply: bytes) -> None:
        """Send a reply, or put it into the outbox; returns at once. Any thread may call it."""
        with self._lock:
            if self._closed:
                return
            sent = 0
            if not self._outbox:
                try:
                    sent = self.socket.send(reply)
                except BlockingIOError:
                    pass
                except OSError:
                    self._closed = True
                if sent == len(reply):
                    return
            self._keep(memoryview(reply)[sent:])
        self._notify(self)

    def _keep(self, unsent: memoryview) -> None:
        """Put what was not sent into the outbox; a client for which there is no room must go."""
        if self._closed or not self._budget.take(len(unsent)):
            self._closed = True
            return
        if not self._outbox:
            self.progressed_at = time.monotonic()
        self._outbox.append(unsent)

    @property
    def is_closed(self) -> bool:
        """Whether a reply could not be sent or kept, so that the client must go."""
        return self._closed

    def close(self) -> None:
        """Close the socket and forget what was under way."""
        with self._lock:
            self._closed = True
            self._budget.give(sum(map(len, self._outbox)))
            self._outbox.clear()
            self.socket.close()
        self._forget_arriving()

    def _read_into(self, arriving: _Arriving) -> bool:
        size = self.socket.recv_into(arriving.missing)
        arriving.missing = arriving.missing[size:]
        if not arriving.missing:
            self._forget_arriving()
            self._hand_on(arriving.model, arriving.head, arriving.windows, self._core.submit)
        return size > 0

    def _forget_arriving(self) -> None:
        if self._arriving is not None:
            self._budget.give(self._arriving.windows.nbytes)
            self._arriving = None

    def _take_requests(self, data: bytes, alone: bool) -> None:
        """Pass on the requests in `data`, which starts with the head of one."""
        at, end = 0, len(data)
        while end - at >= HEAD_BYTES:
            head = read_request_head(data, at)
            start, stop = at + head.data_at, at + head.size
            if start > end:
                break
            infer = self._core.run if alone and stop == end and not at else self._core.submit
            try:
                model = self._model_of(head, data[at + HEAD_BYTES : at + HEAD_BYTES + head.path_bytes])
                if stop > end:
                    self._await_rest(head, model, memoryview(data)[start:])
            except RequestError as error:
                self.send(pack_reply(head.id, error))
                self._to_skip = max(stop - end, 0)
            else:
                if stop <= end:
                    count = head.rows * head.columns
                    windows = np.frombuffer(data, "<f4", count, start).reshape(head.rows, head.columns)
                    # A window that waits must not keep all the bytes that it came with.
                    self._hand_on(model, head, windows if head.size == end else windows.copy(), infer)
            at = stop
        self._rest = data[at:]

    def _await_rest(self, head: RequestHead, model: LoadedModel, data: memoryview) -> None:
        size = head.size - head.data_at
        if not self._budget.take(size):
            raise ResourceExhausted("too many large requests arrive at the same time; try again later")
        self._arriving = _Arriving(head, model)
        self._arriving.fill(data)

    def _model_of(self, head: RequestHead, path: bytes) -> LoadedModel:
        """The model that a request asks, if it may: called before its windows are read."""
        told = path.decode(errors="replace")
        model = self._core.model_at(told)
        if model is None:
            self._core.answer(told)
            raise NotFound(f"{told!r} is no inference: expected v2/models/NAME[/versions/VERSION]/infer")
        check_shape(model, (head.rows, head.columns))
        if head.rows > self._core.max_request_rows:
            raise ResourceExhausted(
                f"inputs[0].shape: {head.rows} rows: "
                f"expected at most {self._core.max_request_rows} in one request"
            )
        return model

    def _hand_on(
        self,
        model: LoadedModel,
        head: RequestHead,
        windows: NDArray[np.float32],
        infer: Callable[[Job], None],
    ) -> None:
        try:
            infer(LaneJob(self, model, head, windows))
        except RequestError as error:
            _LOG.debug("%s: %s: %s", model.label, error.code, error)
            self.send(pack_reply(head.id, error))
        except Exception:
            _LOG.exception("a request could not be handed on")
            self.send(pack_reply(head.id, Internal("the request failed: the server's log says more")))

"""One client of the lane: what it sends becomes jobs, and their answers go back, without ever blocking.

The lane's thread reads. Whoever has an answer sends it, as far as the client takes it at once; what is
left waits in the outbox for the lane's thread. Nothing is read from a client whose outbox is not empty.
"""

import logging
import socket
import time
from collections import deque
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import Internal, InvalidArgument, NotFound, RequestError, ResourceExhausted
from taxel.lane.frames import (
    CANCELLATION,
    HEAD_BYTES,
    ID_AT,
    ID_END,
    KIND_AT,
    RequestHead,
    pack_predictions,
    pack_reply,
    read_cancel,
    read_request_head,
)
from taxel.lane.offer import name_of, process_of
from taxel.protocol import CANCEL
from taxel.trace_context import TRACE_CONTEXT, trace_id_of
from taxel_server.core.core import Core
from taxel_server.core.jobs import check_shape
from taxel_server.core.policy import Ticket
from taxel_server.engine import LoadedModel
from taxel_server.transports.lane_requests import Arriving, Budget, LaneJob, Repeated, may_be_repeated
from taxel_server.transports.poller import READ

_LOG: Final = logging.getLogger(__name__)

EXTENSIONS: Final = (CANCEL, TRACE_CONTEXT)
"""What a client may send beyond requests."""

RECEIVE_BYTES: Final = 65_536
"""The most that is received at once."""

_KINDS: Final = 64
"""Sizes of requests that are remembered, the last that were new: a model has 16 that are answered alone."""


class ClientConnection:
    """Reads requests and sends replies; all methods but `send` belong to the lane's thread.

    Args:
        client: its socket, which does not block.
        core: what answers.
        budget: of requests in part and of replies that wait.
        buffer: to receive into, of `RECEIVE_BYTES`; all clients share it.
        notify: tells the lane's thread that the outbox is no longer empty, or that the client has gone.
    """

    def __init__(
        self,
        client: socket.socket,
        core: Core,
        budget: Budget,
        buffer: bytearray,
        notify: Callable[["ClientConnection"], None],
    ) -> None:
        self.socket = client
        self.awaited = READ
        """Which event the lane's thread waits for."""
        self.progressed_at = 0.0
        """When bytes last moved while a request or a reply was under way."""
        self._name = name_of(client)
        # Each thread of a client has a connection of its own; a process has one share.
        self._client: Hashable = process_of(client) or self
        self._core = core
        self._budget = budget
        self._notify = notify
        self._remaining = b""
        """The start of a request whose head or path is not there yet."""
        self._arriving: Arriving | None = None
        self._buffer = buffer
        self._received: bytes | None = None
        """What was read and not looked at."""
        self._repeated: dict[int, Repeated] = {}
        """The last request of each size: a control loop sends the same again, with other windows."""
        self._to_skip = 0
        """Bytes of a refused request that are still to come."""
        self._outbox: deque[memoryview] = deque()
        self._closed = False
        self._owed = 0
        """Frames that have come, each owed a reply; the lane's thread counts them."""
        self._replied = 0
        self._at_end = False
        """Whether bytes came that are no frame: what is owed is still sent, and nothing more is read."""
        self._lock = Lock()
        """Of the outbox, the count of replies and the socket's sending side."""

    @property
    def has_outbox(self) -> bool:
        """Whether replies wait for the client to read."""
        return bool(self._outbox)

    @property
    def is_under_way(self) -> bool:
        """Whether the client owes bytes, or does not read its replies."""
        return bool(self._remaining or self._arriving or self._to_skip or self._outbox or self._at_end)

    @property
    def is_closed(self) -> bool:
        """Whether the client must go: a reply could not be sent or kept, or all is said after no frame."""
        return self._closed or (self._at_end and self._replied == self._owed and not self._outbox)

    def answer_alone(self) -> bool:
        """Read, and answer a small request that is like an earlier one; False if there is more to do.

        No other client has sent anything. What was read otherwise waits for `read`.
        """
        if self._arriving is not None or self.is_under_way:
            return False
        buffer = self._buffer
        size = self.socket.recv_into(buffer)
        repeated = self._repeated.get(size)
        if repeated is not None and repeated.is_there():
            model = self._core.model_at(repeated.path)
            if model and (done := self._core.evaluate_if_idle(model, repeated.windows)) is not None:
                self._owed += 1
                request_id = int.from_bytes(buffer[ID_AT:ID_END], "little")
                self.send(pack_predictions(request_id, done.counts, len(done.counts), 0, done.compute_us))
                if (traffic := self._core.traffic) is not None:
                    traffic.note(self._name, model, repeated.windows, done.counts, done.compute_us)
                return not self._closed
        self._received = bytes(memoryview(buffer)[:size])
        return False

    def read(self) -> bool:
        """Take what has arrived and pass whole requests on; False if the client has gone or must go."""
        self.progressed_at = time.monotonic()
        if self._arriving is not None:
            return self._read_into(self._arriving)
        data = self._received
        if data is None:
            size = self.socket.recv_into(self._buffer)
            data = bytes(memoryview(self._buffer)[:size])
        self._received = None
        if not data:
            return False
        if self._at_end:
            return True
        if self._to_skip:
            skipped = min(self._to_skip, len(data))
            self._to_skip -= skipped
            data = data[skipped:]
        if self._remaining:
            data = self._remaining + data
            self._remaining = b""
        try:
            self._take_requests(data)
        except InvalidArgument as error:
            # Where the next request starts is not known any more.
            self._core.refusals.add(error, client=self._name)
            self._remaining = b""
            self._owed += 1
            self._at_end = True
            self.send(pack_reply(0, error))
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
            self._replied += 1
            sent = 0
            if not self._outbox:
                try:
                    sent = self.socket.send(reply)
                except BlockingIOError:
                    pass
                except OSError:
                    self._closed = True
            if sent < len(reply):
                self._keep(memoryview(reply)[sent:])
            elif not self._at_end:
                return
        self._notify(self)

    def _keep(self, unsent: memoryview) -> None:
        """Put what was not sent into the outbox; a client for which there is no room must go."""
        if self._closed or not self._budget.take(len(unsent)):
            self._closed = True
            return
        if not self._outbox:
            self.progressed_at = time.monotonic()
        self._outbox.append(unsent)

    def close(self) -> None:
        """Close the socket and forget what was under way."""
        with self._lock:
            self._closed = True
            self._budget.give(sum(map(len, self._outbox)))
            self._outbox.clear()
            self.socket.close()
        self._forget_arriving()
        self._core.gone(self)

    def _read_into(self, arriving: Arriving) -> bool:
        size = self.socket.recv_into(arriving.missing)
        self.progressed_at = time.monotonic()
        arriving.missing = arriving.missing[size:]
        if not arriving.missing:
            self._forget_arriving()
            head = arriving.head
            self._hand_on(arriving.model, head, arriving.windows)
        return size > 0

    def _forget_arriving(self) -> None:
        if self._arriving is not None:
            self._budget.give(self._arriving.windows.nbytes)
            self._arriving = None

    def _take_requests(self, data: bytes) -> None:
        """Pass on the requests in `data`, which starts with the head of one."""
        at, end = 0, len(data)
        while end - at >= HEAD_BYTES:
            if data[at + KIND_AT] == CANCELLATION:
                self._core.cancel((self, read_cancel(data, at)))
                at += HEAD_BYTES
                continue
            head = read_request_head(data, at)
            start, stop = at + head.data_at, at + head.size
            if start > end:
                break
            self._owed += 1
            try:
                path = data[at + HEAD_BYTES : at + HEAD_BYTES + head.path_bytes].decode(errors="replace")
                model = self._model_of(head, path)
                if stop > end:
                    self._await_remaining(head, model, memoryview(data)[start:])
            except RequestError as error:
                self._refused(error, head)
                self.send(pack_reply(head.id, error))
                self._to_skip = max(stop - end, 0)
            else:
                if stop <= end:
                    count = head.rows * head.columns
                    windows = np.frombuffer(data, "<f4", count, start).reshape(head.rows, head.columns)
                    # A window that waits must not keep all the bytes that it came with.
                    if head.size < end:
                        windows = windows.copy()
                    self._hand_on(model, head, windows)
                    if head.size == end <= RECEIVE_BYTES and may_be_repeated(head):
                        self._remember(data, head, path)
            at = stop
        self._remaining = data[at:]

    def _remember(self, data: bytes, head: RequestHead, path: str) -> None:
        """Expect more requests like this one."""
        if head.size not in self._repeated and len(self._repeated) >= _KINDS:
            del self._repeated[next(iter(self._repeated))]
        self._buffer[: len(data)] = data
        self._repeated[head.size] = Repeated(self._buffer, head, path)

    def _await_remaining(self, head: RequestHead, model: LoadedModel, data: memoryview) -> None:
        size = head.size - head.data_at
        self._core.check_room(Ticket(self._client, model, head.rows, head.size))
        if not self._budget.take(size):
            raise ResourceExhausted("too many large requests arrive at the same time; try again later")
        self._arriving = Arriving(head, model)
        self._arriving.fill(data)

    def _model_of(self, head: RequestHead, path: str) -> LoadedModel:
        """The model that a request asks, if it may: called before its windows are read."""
        model = self._core.model_at(path)
        if model is None:
            self._core.answer(path)
            raise NotFound(f"{path!r} is no inference: expected v2/models/NAME[/versions/VERSION]/infer")
        check_shape(model, (head.rows, head.columns))
        if head.rows > self._core.max_request_rows:
            raise ResourceExhausted(
                f"inputs[0].shape: {head.rows} rows: "
                f"expected at most {self._core.max_request_rows} in one request"
            )
        return model

    def _hand_on(self, model: LoadedModel, head: RequestHead, windows: NDArray[np.float32]) -> None:
        try:
            job = LaneJob(self.send, model, head, windows, self._client, self)
            job.caller = self._name
            self._core.submit(job)
        except RequestError as error:
            self._refused(error, head, model.label)
            self.send(pack_reply(head.id, error))
        except Exception:
            _LOG.exception("a request could not be handed on")
            self.send(pack_reply(head.id, Internal("the request failed: the server's log says more")))

    def _refused(self, error: RequestError, head: RequestHead, model: str = "") -> None:
        self._core.refusals.add(
            error,
            client=self._name,
            model=model,
            request_id=head.id,
            trace_id=trace_id_of(head.traceparent),
        )

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

from taxel.errors import Internal, InvalidArgument, NotFound, RequestError, ResourceExhausted
from taxel.lane.frames import HEAD_BYTES, ID_AT, RequestHead, pack_reply, read_request_head
from taxel.lane.offer import name_of
from taxel_server.core.core import Core
from taxel_server.core.jobs import Job, check_shape
from taxel_server.engine import LoadedModel
from taxel_server.transports.lane_requests import Arriving, Budget, LaneJob, Last

_LOG: Final = logging.getLogger(__name__)

_RECEIVE_BYTES: Final = 65_536


class ClientConnection:
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
        notify: Callable[["ClientConnection"], None],
    ) -> None:
        self.socket = client
        self.progressed_at = 0.0
        """When bytes last moved while a request or a reply was under way."""
        self._name = name_of(client)
        self._core = core
        self._budget = budget
        self._notify = notify
        self._rest = b""
        """The start of a request whose head or path is not there yet."""
        self._arriving: Arriving | None = None
        self._last: Last | None = None
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

    @property
    def is_closed(self) -> bool:
        """Whether a reply could not be sent or kept, so that the client must go."""
        return self._closed

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
            self._core.refusals.add(error, client=self._name)
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

    def close(self) -> None:
        """Close the socket and forget what was under way."""
        with self._lock:
            self._closed = True
            self._budget.give(sum(map(len, self._outbox)))
            self._outbox.clear()
            self.socket.close()
        self._forget_arriving()

    def _read_into(self, arriving: Arriving) -> bool:
        size = self.socket.recv_into(arriving.missing)
        arriving.missing = arriving.missing[size:]
        if not arriving.missing:
            self._forget_arriving()
            head = arriving.head
            self._hand_on(arriving.model, head, head.id, arriving.windows, self._core.submit)
        return size > 0

    def _forget_arriving(self) -> None:
        if self._arriving is not None:
            self._budget.give(self._arriving.windows.nbytes)
            self._arriving = None

    def _take_requests(self, data: bytes, alone: bool) -> None:
        """Pass on the requests in `data`, which starts with the head of one."""
        last = self._last
        if alone and last is not None and last.is_like(data):
            head = last.head
            windows = np.frombuffer(data, "<f4", offset=head.data_at).reshape(head.rows, head.columns)
            request_id = int.from_bytes(data[ID_AT : ID_AT + 4], "little")
            self._hand_on(last.model, head, request_id, windows, self._core.run)
            return
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
                self._core.refusals.add(error, client=self._name, request_id=head.id)
                self.send(pack_reply(head.id, error))
                self._to_skip = max(stop - end, 0)
            else:
                if stop <= end:
                    count = head.rows * head.columns
                    windows = np.frombuffer(data, "<f4", count, start).reshape(head.rows, head.columns)
                    # A window that waits must not keep all the bytes that it came with.
                    if head.size < end:
                        windows = windows.copy()
                    self._hand_on(model, head, head.id, windows, infer)
                    if not at:
                        self._last = Last(data[:ID_AT], data[ID_AT + 4 : start], head, model)
            at = stop
        self._rest = data[at:]

    def _await_rest(self, head: RequestHead, model: LoadedModel, data: memoryview) -> None:
        size = head.size - head.data_at
        if not self._budget.take(size):
            raise ResourceExhausted("too many large requests arrive at the same time; try again later")
        self._arriving = Arriving(head, model)
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
        request_id: int,
        windows: NDArray[np.float32],
        infer: Callable[[Job], None],
    ) -> None:
        try:
            infer(LaneJob(self.send, model, head, request_id, windows, self._name))
        except RequestError as error:
            self._core.refusals.add(error, client=self._name, model=model.label, request_id=request_id)
            self.send(pack_reply(request_id, error))
        except Exception:
            _LOG.exception("a request could not be handed on")
            self.send(pack_reply(request_id, Internal("the request failed: the server's log says more")))

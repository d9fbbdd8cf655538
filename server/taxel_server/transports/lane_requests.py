"""Requests of the lane: as jobs, while they arrive, and the last one of a client."""

from collections.abc import Callable
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.errors import RequestError
from taxel.lane.frames import ID_AT, RequestHead, pack_reply
from taxel.protocol import InferRequest, InferResponse, checked_timeout_ms
from taxel_server.core.jobs import Job
from taxel_server.engine import LoadedModel


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
        send: Callable[[bytes], None],
        model: LoadedModel,
        head: RequestHead,
        request_id: int,
        windows: NDArray[np.float32],
        client: str,
    ) -> None:
        super().__init__(model, head.rows)
        self.client = client
        self._send = send
        self._head = head
        self.request_id: int = request_id
        self._windows = windows

    @override
    def decode(self) -> InferRequest:
        timeout_ms = checked_timeout_ms(self._head.timeout_ms) if self._head.timeout_ms else None
        return InferRequest(self._windows, None, timeout_ms, self._head.spread)

    @override
    def answer(self, result: InferResponse | RequestError) -> None:
        self._send(pack_reply(self.request_id, result))


class Arriving:
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


class Last(NamedTuple):
    """The last request: in a control loop, the next one differs only in its id and its windows.

    Attributes:
        before: the bytes before the id.
        after: the bytes between the id and the windows.
        head: of the request.
        model: that it asks.
    """

    before: bytes
    after: bytes
    head: RequestHead
    model: LoadedModel

    def is_like(self, data: bytes) -> bool:
        """Whether `data` is one request that differs in nothing else, so that its checks need no repeat."""
        return (
            len(data) == self.head.size
            and data[:ID_AT] == self.before
            and data[ID_AT + 4 : self.head.data_at] == self.after
        )

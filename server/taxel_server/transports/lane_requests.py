"""Requests of the lane: as jobs, while they arrive, and the last one of a client."""

from collections.abc import Callable, Hashable
from math import inf
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.errors import RequestError
from taxel.lane.frames import ID_AT, ID_END, RequestHead, pack_reply
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
        windows: NDArray[np.float32],
        client: Hashable,
        source: Hashable,
    ) -> None:
        super().__init__(model, head.rows, head.size, client, source, name=(source, head.id))
        self._send = send
        self._head = head
        self.request_id: int = head.id
        self.traceparent = head.traceparent
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


def may_be_repeated(head: RequestHead) -> bool:
    """Whether the next request that differs only in its id and its windows needs no other checks."""
    return not head.spread and head.traceparent is None and 0 <= head.timeout_ms < inf


class Repeated:
    """A request as a control loop sends it: the next one differs only in its id and its windows.

    Args:
        buffer: that requests are received into.
        head: of the request that `buffer` holds, as `may_be_repeated` accepts it.
        path: that it asks.

    Attributes:
        path: that it asks; its model may change.
        windows: (n, f) float32, a view of those that the buffer holds now.
    """

    def __init__(self, buffer: bytearray, head: RequestHead, path: str) -> None:
        self.path = path
        self.windows = np.ndarray((head.rows, head.columns), "<f4", buffer, head.data_at)
        self.windows.flags.writeable = False
        self._buffer = buffer
        self._before = bytes(buffer[:ID_AT])
        self._after = bytes(buffer[ID_END : head.data_at])

    def is_there(self) -> bool:
        """Whether the buffer starts with a request that differs in nothing else."""
        return self._buffer.startswith(self._before) and self._buffer.startswith(self._after, ID_END)

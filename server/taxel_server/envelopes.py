"""Decodes requests; what one client asks again and again is decoded once.

Its requests differ in their numbers only. All bytes around the numbers are a request's envelope:
where it is that of an earlier request, so is all that it says, checks included.
"""

from typing import Final, NamedTuple

import numpy as np

from taxel.errors import RequestError
from taxel.protocol import SMALL, InferRequest, unpack_infer_request

_MOST: Final = 64
"""Envelopes that are remembered; whoever sends others has each request decoded."""


class _Said(NamedTuple):
    """What an envelope says."""

    shape: tuple[int, ...]
    timeout_ms: float | None
    spread: bool


class RequestReader:
    """Decodes infer requests of at most so many windows. Thread-safe."""

    def __init__(self, max_rows: int) -> None:
        self._max_rows = max_rows
        self._places: dict[int, tuple[int, int]] = {}
        """Where the numbers begin and end in a request of so many bytes."""
        self._known: dict[tuple[int, bytes], _Said] = {}
        """By the bytes of a request, how many and which envelope."""

    def read(self, payload: bytes) -> InferRequest:
        """Decodes a request; its windows are a read-only view of its bytes.

        Raises:
            RequestError: as `taxel.protocol.unpack_infer_request` does.
        """
        place = self._places.get(len(payload))
        if place is not None:
            start, stop = place
            said = self._known.get((len(payload), payload[:start] + payload[stop:]))
            if said is not None:
                windows = np.frombuffer(payload, "<f4", (stop - start) // 4, start)
                return InferRequest(windows.reshape(said.shape), None, said.timeout_ms, said.spread)
        request = unpack_infer_request(payload, self._max_rows)
        if request.id is None and request.windows.nbytes <= SMALL and len(self._known) < _MOST:
            self._remember(payload, request)
        return request

    def _remember(self, payload: bytes, request: InferRequest) -> None:
        """Remembers an envelope, if other numbers at what looks like their place are decoded as such."""
        shape, numbers = request.windows.shape, request.windows.tobytes()
        start = payload.find(numbers)
        stop = start + len(numbers)
        others = bytes(255 - byte for byte in numbers)
        try:
            probe = unpack_infer_request(payload[:start] + others + payload[stop:], self._max_rows)
        except RequestError:
            return
        if (probe.windows.shape, probe.windows.tobytes()) != (shape, others):
            return
        if self._places.setdefault(len(payload), (start, stop)) == (start, stop):
            envelope = payload[:start] + payload[stop:]
            self._known[len(payload), envelope] = _Said(shape, request.timeout_ms, request.spread)

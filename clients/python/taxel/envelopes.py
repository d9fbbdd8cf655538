"""Encodes and decodes requests over zenoh. What the requests of one client have in common is done once.

Such requests differ only in their numbers. All bytes around the numbers are the envelope of a request.
A request with the envelope of an earlier request says the same, so its checks are not repeated.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.errors import RequestError, ResourceExhausted
from taxel.protocol import InferRequest, pack_infer_request, unpack_infer_request

_SMALL: Final = 4096
"""The most bytes of numbers in a request whose envelope is kept."""

_MOST_KNOWN: Final = 64
"""Envelopes that are kept. Requests with further envelopes are decoded each time."""

_LEAST_BYTES: Final = 64
"""The smallest envelope: names, datatype, shape."""

_MOST_BYTES: Final = 4096
"""The largest envelope that is accepted: with an id and parameters."""

_FLOAT_BYTES: Final = 4


class _Envelope(NamedTuple):
    """What an envelope says about its request."""

    shape: tuple[int, ...]
    timeout_ms: float | None
    spread: bool


class RequestWriter:
    """Encodes infer requests. Thread-safe."""

    def __init__(self) -> None:
        self._known: dict[tuple[tuple[int, ...], float, bool], tuple[bytes, bytes]] = {}
        """The bytes before and after the numbers, by shape, timeout and spread."""

    def write(
        self,
        windows: NDArray[np.float32],
        timeout_ms: float,
        *,
        spread: bool = False,
        traceparent: str | None = None,
    ) -> bytes:
        """The same bytes as `taxel.protocol.pack_infer_request` gives."""
        # A trace context is another one each time.
        if traceparent is not None or not 0 < windows.nbytes <= _SMALL:
            return pack_infer_request(
                windows, timeout_ms=timeout_ms, spread=spread, traceparent=traceparent
            )
        what = (windows.shape, timeout_ms, spread)
        known = self._known.get(what)
        if known is None:
            marks = np.frombuffer(b"\xff" * windows.nbytes, np.float32).reshape(windows.shape)
            packed = pack_infer_request(marks, timeout_ms=timeout_ms, spread=spread)
            before, _, after = packed.partition(marks.tobytes())
            known = before, after
            if len(self._known) < _MOST_KNOWN:
                self._known[what] = known
        return b"".join((known[0], windows.astype("<f4", copy=False).data, known[1]))


class RequestReader:
    """Decodes infer requests. Thread-safe.

    Args:
        max_rows: the most windows in one request.
    """

    def __init__(self, max_rows: int) -> None:
        self._max_rows = max_rows
        self._places: dict[int, tuple[int, int]] = {}
        """Where the numbers start and stop, by the request's size in bytes."""
        self._known: dict[tuple[int, bytes], _Envelope] = {}
        """Envelopes by the request's size in bytes and the envelope's bytes."""

    def rows_in(self, size: int, features: int) -> int:
        """The number of windows in a request of `size` bytes, estimated before it is decoded.

        Args:
            features: the number of columns of a window.

        Raises:
            ResourceExhausted: one request may not have so many windows.
        """
        row_bytes = features * _FLOAT_BYTES
        if size > self._max_rows * row_bytes + _MOST_BYTES:
            raise ResourceExhausted(
                f"inputs[0].data: a request of {size} bytes: "
                f"expected at most {self._max_rows} rows of {features} float32 in one request"
            )
        return min(max((size - _LEAST_BYTES) // row_bytes, 1), self._max_rows)

    def read(self, payload: bytes) -> InferRequest:
        """Decode a request. Its windows are a read-only view of its bytes.

        Raises:
            RequestError: see `taxel.protocol.unpack_infer_request`.
        """
        place = self._places.get(len(payload))
        if place is not None:
            start, stop = place
            known = self._known.get((len(payload), payload[:start] + payload[stop:]))
            if known is not None:
                windows = np.frombuffer(payload, "<f4", (stop - start) // _FLOAT_BYTES, start)
                return InferRequest(windows.reshape(known.shape), None, known.timeout_ms, known.spread)
        request = unpack_infer_request(payload, self._max_rows)
        is_alike = request.id is None and request.traceparent is None
        if is_alike and request.windows.nbytes <= _SMALL and len(self._known) < _MOST_KNOWN:
            self._remember(payload, request)
        return request

    def _remember(self, payload: bytes, request: InferRequest) -> None:
        """Keep an envelope, if a request with other numbers at the same place decodes to those numbers."""
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
            self._known[len(payload), envelope] = _Envelope(shape, request.timeout_ms, request.spread)

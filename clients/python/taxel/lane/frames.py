"""The lane's frames, as both ends write and read them. docs/wire_lane.md shows every byte.

A frame is a head of 32 bytes, then its content; every number is little-endian, every frame a multiple of 4
bytes long, so that windows and counts can be read in place.
"""

from struct import Struct
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import Internal, InvalidArgument, RequestError
from taxel.protocol import InferResponse, pack_error, unpack_error
from taxel.trace_context import is_traceparent

MAGIC: Final = b"TXL1"
"""The first bytes of each frame: Taxel's lane, version 1."""

HEAD_BYTES: Final = 32
ID_AT: Final = 12
ID_END: Final = ID_AT + 4
"""Where the four bytes of the id stand in a head."""

MAX_PATH_BYTES: Final = 512
"""The longest path in a request."""

MAX_ERROR_BYTES: Final = 65_536
"""The longest error in a reply."""

REQUEST: Final = 1
PREDICTIONS: Final = 2
ERROR: Final = 3
CANCELLATION: Final = 4

KIND_AT: Final = 8
"""Where the kind stands in a head."""

_SPREAD: Final = 1
"""The flag of a request for the spread, and of a reply that has it."""

_TRACED: Final = 2
"""The flag of a request with a traceparent behind its path."""

_TRACE_BYTES: Final = 56
"""Its 55 characters, and a zero byte."""

_REQUEST: Final = Struct("<4sIBBHIIId")
_REPLY: Final = Struct("<4sIBBHIIIII")
_FLOAT: Final = np.dtype("<f4")
_COLUMNS: Final = len(CHANNELS)


class RequestHead(NamedTuple):
    """What the head of a request says.

    Attributes:
        size: bytes of the whole frame.
        spread: whether it asks for the spread.
        path_bytes: length of the path, such as `v2/models/xgb/infer`, without its padding.
        id: chosen by the client; the reply repeats it.
        rows: windows.
        columns: numbers of a window.
        timeout_ms: how long the client waits; 0 for as long as it takes.
        data_at: where the windows start, in bytes from the start of the frame.
        traceparent: of the W3C; None if it has none, or not all of it is there.
    """

    size: int
    spread: bool
    path_bytes: int
    id: int
    rows: int
    columns: int
    timeout_ms: float
    data_at: int
    traceparent: str | None = None


class ReplyHead(NamedTuple):
    """What the head of a reply says.

    Attributes:
        size: bytes of the whole frame.
        kind: `PREDICTIONS` or `ERROR`.
        spread: whether the spread follows the counts.
        id: of the request.
        rows: windows that were evaluated; 0 in an error.
        batch_rows, queue_us, compute_us: as in `InferResponse`.
    """

    size: int
    kind: int
    spread: bool
    id: int
    rows: int
    batch_rows: int
    queue_us: int
    compute_us: int


def pack_request_head(
    path: str,
    request_id: int,
    shape: tuple[int, ...],
    timeout_ms: float,
    *,
    spread: bool,
    traceparent: str | None = None,
) -> bytes:
    """The bytes of a request before its windows, (n, f) float32 of the shape given."""
    encoded = path.encode()
    padded = encoded.ljust(_padded(len(encoded)), b"\0")
    flags = spread * _SPREAD
    if traceparent is not None:
        flags |= _TRACED
        padded += traceparent.encode().ljust(_TRACE_BYTES, b"\0")
    rows, columns = shape
    size = HEAD_BYTES + len(padded) + rows * columns * _FLOAT.itemsize
    head = _REQUEST.pack(MAGIC, size, REQUEST, flags, len(encoded), request_id, rows, columns, timeout_ms)
    return head + padded


def read_request_head(data: bytes, at: int) -> RequestHead:
    """The head of the request whose frame starts at a place of `data`; 32 bytes must be there.

    Raises:
        InvalidArgument: no frame of a request starts there, so that none behind it can be found either.
    """
    magic, size, kind, flags, path_bytes, request_id, rows, columns, timeout_ms = _REQUEST.unpack_from(
        data, at
    )
    data_at = HEAD_BYTES + _padded(path_bytes)
    traceparent = None
    if flags & _TRACED:
        data_at += _TRACE_BYTES
        told = data[at + data_at - _TRACE_BYTES : at + data_at].rstrip(b"\0").decode(errors="replace")
        traceparent = told if is_traceparent(told) else None
    if magic != MAGIC or kind != REQUEST or flags > _SPREAD | _TRACED:
        raise InvalidArgument(
            f"frame: it starts with {bytes(data[at : at + 10])!r}: expected {MAGIC!r} and a request"
        )
    if path_bytes > MAX_PATH_BYTES:
        raise InvalidArgument(f"frame: a path of {path_bytes} bytes: expected at most {MAX_PATH_BYTES}")
    expected = data_at + rows * columns * _FLOAT.itemsize
    if size != expected:
        raise InvalidArgument(
            f"frame: {size} bytes: expected {expected} "
            f"for a path of {path_bytes} bytes and shape [{rows}, {columns}]"
        )
    spread = bool(flags & _SPREAD)
    return RequestHead(
        size, spread, path_bytes, request_id, rows, columns, timeout_ms, data_at, traceparent
    )


def pack_cancel(request_id: int) -> bytes:
    """The frame by which a client gives a request up; it has no reply of its own."""
    return _REQUEST.pack(MAGIC, HEAD_BYTES, CANCELLATION, 0, 0, request_id, 0, 0, 0.0)


def read_cancel(data: bytes, at: int) -> int:
    """The id of the request that is given up by the frame at a place of `data`; 32 bytes must be there.

    Raises:
        InvalidArgument: another number is in the frame than the id, so that it means something else.
    """
    frame = data[at : at + HEAD_BYTES]
    request_id = int.from_bytes(frame[ID_AT:ID_END], "little")
    if frame != pack_cancel(request_id):
        raise InvalidArgument(f"frame: it is {frame!r}: expected a cancellation, with nothing but an id")
    return request_id


def pack_reply(request_id: int, result: InferResponse | RequestError) -> bytes:
    """The frame of a reply."""
    if isinstance(result, RequestError):
        content = pack_error(result)
        content = content.ljust(_padded(len(content)), b"\0")
        size = HEAD_BYTES + len(content)
        return _REPLY.pack(MAGIC, size, ERROR, 0, 0, request_id, 0, 0, 0, 0) + content
    return pack_predictions(
        request_id, result.outputs, result.batch_rows, result.queue_us, result.compute_us, result.spread
    )


def pack_predictions(
    request_id: int,
    counts: NDArray[np.float32],
    batch_rows: int,
    queue_us: int,
    compute_us: int,
    spread: NDArray[np.float32] | None = None,
) -> bytes:
    """The frame of a reply with counts (n, 21), and the spread (n, 21) if it was asked for."""
    content = counts.astype(_FLOAT, copy=False).tobytes()
    if spread is not None:
        content += spread.astype(_FLOAT, copy=False).tobytes()
    size = HEAD_BYTES + len(content)
    head = _REPLY.pack(
        MAGIC,
        size,
        PREDICTIONS,
        spread is not None,
        _COLUMNS,
        request_id,
        len(counts),
        batch_rows,
        queue_us,
        compute_us,
    )
    return head + content


def read_reply_head(data: bytes | bytearray) -> ReplyHead:
    """The head of a reply, its first 32 bytes.

    Raises:
        Internal: that is no reply of the lane.
    """
    magic, size, kind, flags, columns, request_id, rows, *times = _REPLY.unpack_from(data)
    if magic == MAGIC and kind == PREDICTIONS and columns == _COLUMNS and flags <= _SPREAD:
        expected = HEAD_BYTES + rows * columns * _FLOAT.itemsize * (1 + flags)
        if size == expected:
            return ReplyHead(size, kind, flags == _SPREAD, request_id, rows, *times)
    if magic == MAGIC and kind == ERROR and HEAD_BYTES < size <= HEAD_BYTES + MAX_ERROR_BYTES:
        return ReplyHead(size, kind, False, request_id, 0, 0, 0, 0)
    raise Internal(f"the server's reply starts with {bytes(data[:HEAD_BYTES])!r}: expected the lane's")


def read_error(content: bytes | bytearray) -> RequestError:
    """The error of a reply, from its content."""
    return unpack_error(bytes(content).rstrip(b"\0"))


def read_counts(content: bytes | bytearray, head: ReplyHead) -> list[NDArray[np.float32]]:
    """The counts (n, 21) of a reply, and its spread (n, 21) if it has it, for the caller to change.

    Raises:
        RequestError: the reply is an error.
    """
    if head.kind == ERROR:
        raise read_error(content)
    counts = np.frombuffer(content, _FLOAT)
    if not counts.flags.writeable:
        counts = counts.copy()
    if not head.spread:
        return [counts.reshape(head.rows, _COLUMNS)]
    return list(counts.reshape(2, head.rows, _COLUMNS))


def _padded(size: int) -> int:
    """The next multiple of 4."""
    return (size + 3) & ~3

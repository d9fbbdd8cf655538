"""Mutated requests against a live server: each is answered once, with numbers or a typed error."""

import socket
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Final

import zenoh

from taxel.errors import Internal, InvalidArgument, RequestError
from taxel.lane.frames import (
    ERROR,
    HEAD_BYTES,
    pack_request_head,
    read_counts,
    read_error,
    read_reply_head,
    read_request_head,
)
from taxel.lane.offer import connect_to
from taxel.manifest import Manifest
from taxel.protocol import model_key, model_path, pack_infer_request, unpack_error, unpack_infer_response
from taxel.remote import RemoteSource
from taxel.zenoh_process import close_session, open_session
from taxel_bench.plain_client import client_config
from taxel_bench.windows import random_windows

ROWS: Final = 3
"""Windows of the request that is mutated."""

_TIMEOUT_S: Final = 10.0
_IN_FLIGHT: Final = 64
_LARGEST_FILL: Final = 2**20


@dataclass
class Answers:
    """What became of mutated requests.

    Attributes:
        requests: that were sent.
        predictions: that were answered with numbers.
        errors: by code.
        unanswered: requests without an answer.
        repeated: answers beyond the first, or that nobody asked for.
        untyped: answers that are neither predictions nor a typed error.
    """

    requests: int = 0
    predictions: int = 0
    errors: Counter[str] = field(default_factory=Counter)
    unanswered: int = 0
    repeated: int = 0
    untyped: int = 0

    def add(self, error: RequestError | None) -> None:
        """Note an answer: predictions, or an error."""
        if error is None:
            self.predictions += 1
        elif isinstance(error, Internal):
            # A fault of the server, or an error that cannot be read.
            self.untyped += 1
        else:
            self.errors[error.code] += 1


def mutated_over_zenoh(source: RemoteSource, manifest: Manifest, payloads: Iterator[bytes]) -> Answers:
    """Send each payload as a query in a session of its own kind, which counts all replies."""
    key = model_key(source.prefix, manifest.name, manifest.version, "infer")
    answers = Answers()
    session = open_session(client_config(source.endpoint))
    try:
        while several := list(islice(payloads, _IN_FLIGHT)):
            asked = [
                session.get(
                    key, payload=payload, timeout=_TIMEOUT_S, consolidation=zenoh.ConsolidationMode.NONE
                )
                for payload in several
            ]
            for replies in asked:
                _take(answers, list(replies))
    finally:
        close_session(session)
    return answers


def _take(answers: Answers, replies: Sequence[zenoh.Reply]) -> None:
    """Note all replies to one query."""
    answers.requests += 1
    timed_out = [each for each in replies if each.err and each.err.payload.to_bytes() == b"Timeout"]
    if len(replies) == len(timed_out):
        answers.unanswered += 1
        return
    answers.repeated += len(replies) - 1
    reply = replies[0]
    if reply.ok is None:
        answers.add(unpack_error(reply.err.payload.to_bytes() if reply.err else b""))
        return
    try:
        unpack_infer_response(reply.ok.payload.to_bytes())
    except RequestError as error:
        answers.add(Internal(str(error)))
    else:
        answers.add(None)


def mutated_over_lane(address: str, manifest: Manifest, frames: Iterator[bytes]) -> Answers:
    """Send each frame, and a right one behind it, and count the replies that the lane's rules owe them."""
    right = valid_frame(manifest)
    answers = Answers()
    connection: socket.socket | None = None
    try:
        for frame in frames:
            owed = owed_replies(frame + right)
            if owed is None:
                continue
            if connection is None:
                connection = connect_to(address)
                connection.settimeout(_TIMEOUT_S)
            answers.requests += 1
            if not _exchange(connection, owed, answers):
                connection.close()
                connection = None
    finally:
        if connection is not None:
            connection.close()
    return answers


def valid_payload(manifest: Manifest) -> bytes:
    """A right request over zenoh."""
    return pack_infer_request(random_windows(manifest, ROWS, 3), timeout_ms=_TIMEOUT_S * 1e3)


def valid_frame(manifest: Manifest, request_id: int = 1) -> bytes:
    """A right request over the lane."""
    windows = random_windows(manifest, ROWS, 3)
    path = model_path(manifest.name, manifest.version, "infer")
    head = pack_request_head(path, request_id, windows.shape, _TIMEOUT_S * 1e3, spread=False)
    return head + windows.astype("<f4").tobytes()


@dataclass(frozen=True)
class Owed:
    """What a stream of frames is owed.

    Attributes:
        stream: the bytes, with zeros for what the last frame says is still to come.
        ids: of the replies, with how many of each.
        ends: whether the stream has a place where no frame starts, after which the server closes it.
    """

    stream: bytes
    ids: Counter[int]
    ends: bool


def owed_replies(stream: bytes) -> Owed | None:
    """One reply for each frame, and one with id 0 where none starts; None if too much is still to come."""
    ids: Counter[int] = Counter()
    at = 0
    while len(stream) - at >= HEAD_BYTES:
        try:
            head = read_request_head(stream, at)
        except InvalidArgument:
            ids[0] += 1
            return Owed(stream, ids, ends=True)
        ids[head.id] += 1
        at += head.size
        if at > len(stream):
            if at - len(stream) > _LARGEST_FILL:
                return None
            stream = stream.ljust(at, b"\0")
    # Fewer bytes than a head are left: a server waits for the rest, so that nothing is owed for them.
    return Owed(stream, ids, ends=at < len(stream))


def _exchange(connection: socket.socket, owed: Owed, answers: Answers) -> bool:
    """Send a stream and take its replies; False if the connection is of no more use."""
    left = owed.ids.copy()
    try:
        connection.sendall(owed.stream)
        while left.total():
            head = read_reply_head(_receive(connection, HEAD_BYTES))
            content = _receive(connection, head.size - HEAD_BYTES)
            if not left[head.id]:
                answers.repeated += 1
                return False
            left[head.id] -= 1
            if head.kind == ERROR:
                answers.add(read_error(content))
            else:
                read_counts(content, head)
                answers.add(None)
        # The server closes a stream that has come to an end, and says no more.
        if owed.ends and left[0] == 0 and owed.ids[0]:
            answers.repeated += bool(connection.recv(1))
    except Internal:
        answers.untyped += 1
        return False
    except (OSError, EOFError):
        answers.unanswered += left.total()
        return False
    return not owed.ends


def _receive(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = connection.recv(size - len(data))
        if not part:
            raise EOFError
        data += part
    return data

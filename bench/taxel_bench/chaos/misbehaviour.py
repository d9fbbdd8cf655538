"""Clients that do not read, that vanish, and that take all of a server's open files; and a full disk."""

import socket
import struct
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

import psutil

from taxel.errors import InvalidArgument
from taxel.lane.offer import LaneOffer, connect_to
from taxel.manifest import Manifest
from taxel.protocol import unpackb
from taxel.remote import RemoteSource
from taxel_bench.chaos.bystander import Bystander
from taxel_bench.chaos.mutated import valid_frame

UNREAD: Final = 20_000
"""Requests that a slow reader sends at most, without reading an answer."""

VANISHED: Final = 100
SPARE_FILES: Final = 8
"""Files that a server may still open when all are to be used up."""

FULL_DISK: Final = Path("/dev/full")
"""Each write to it fails as on a full disk; Linux only."""

_BLOCKED_S: Final = 1.0
_SETTLE_S: Final = 15.0
_RESET: Final = struct.pack("ii", 1, 0)
"""A socket that is closed with this option sends a reset, as if its machine had gone."""


def lane_of(source: RemoteSource) -> str:
    """The address of a server's lane.

    Raises:
        InvalidArgument: it has none.
    """
    offer = LaneOffer.read(unpackb(source.get(f"{source.prefix}/v2")))
    if offer is None:
        raise InvalidArgument(f"{source.endpoint}: the server has no lane: expected one without --lane off")
    return offer.address


def read_slowly(address: str, manifest: Manifest, several: list[Bystander]) -> int:
    """Send and never read, until the server takes no more; requests that it took."""
    frame = valid_frame(manifest)
    sent = 0
    with connect_to(address) as connection:
        connection.settimeout(_BLOCKED_S)
        with suppress(OSError):
            while sent < UNREAD:
                connection.sendall(frame)
                sent += 1
        _let_ask(several)
    return sent


def vanish(address: str, manifest: Manifest, server: psutil.Process) -> int:
    """Clients that go with an answer owed, and in the middle of a request; files that the server keeps."""
    frame = valid_frame(manifest)
    before = server.num_fds()
    for number in range(VANISHED):
        with connect_to(address) as connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            connection.sendall(frame + frame[: number % len(frame)])
    ends = time.monotonic() + _SETTLE_S
    while server.num_fds() > before and time.monotonic() < ends:
        time.sleep(0.1)
    return int(max(server.num_fds() - before, 0))


def use_up_files(address: str, server: psutil.Process, several: list[Bystander]) -> None:
    """Connect until the server can open no more files, let others ask, and go."""
    limits = server.rlimit(psutil.RLIMIT_NOFILE)
    allowed = server.num_fds() + SPARE_FILES
    server.rlimit(psutil.RLIMIT_NOFILE, (allowed, limits[1]))
    try:
        with ExitStack() as connections:
            for _ in range(3 * SPARE_FILES):
                # Those that the server cannot accept wait in its backlog, or are refused.
                with suppress(OSError):
                    connections.enter_context(connect_to(address))
            _let_ask(several)
    finally:
        server.rlimit(psutil.RLIMIT_NOFILE, limits)


def _let_ask(several: list[Bystander]) -> None:
    """Wait until each bystander has had more answers, or an error."""
    wanted = [each.answers + each.failed + 20 for each in several]
    ends = time.monotonic() + _SETTLE_S
    while time.monotonic() < ends and any(
        each.answers + each.failed < want for each, want in zip(several, wanted, strict=True)
    ):
        time.sleep(0.05)

"""Ends zenoh's connections without waiting for what the other end has not read.

zenoh sets `SO_LINGER` to 10 s on each connection. Linux then lets `close` wait for so long, if the other
end has stopped reading and there still is something to send. In a server, zenoh closes on a thread that
receives, and all other clients miss that thread. If it is the one that looks for new messages, nobody
looks for them meanwhile (https://github.com/eclipse-zenoh/zenoh/issues/1101). In a client, a call may wait
for the closing, past its deadline.
"""

import os
import socket
import stat
import struct
from contextlib import suppress
from pathlib import Path
from typing import Final

import zenoh
from zenoh.handlers import Callback

_OPEN: Final = Path("/dev/fd")
"""Where Linux and macOS list the open files of the process that asks."""

_OFF: Final = struct.pack("ii", 0, 0)
"""`struct linger`: `close` returns at once, and the system goes on to send what is left."""


def end_without_lingering(session: zenoh.Session) -> None:
    """Set `SO_LINGER` off on each connection of a session, now and for as long as it is open."""
    # Called by zenoh's own thread: one of Python's would keep the interpreter from ending. Nothing is kept
    # here, and nothing needs to end after a fork: without the listener's object zenoh goes on to call.
    noted: Callback[zenoh.LinkEvent] = Callback(_note, indirect=False)
    session.info.declare_link_events_listener(noted, history=True)


def _note(event: zenoh.LinkEvent) -> None:
    if event.kind == zenoh.SampleKind.PUT:
        turn_off(_port(event.link.src), _port(event.link.dst))


def turn_off(own_port: int | None, their_port: int | None) -> bool:
    """Set `SO_LINGER` off on the connection between two ports; False if there is none in this process."""
    if own_port is None or their_port is None or not _OPEN.is_dir():
        return False
    try:
        numbers = [int(each.name) for each in _OPEN.iterdir()]
    except OSError:  # The process may open no more files, not even this list of them.
        return False
    # From the newest: a new connection has most often the largest number.
    for number in sorted(numbers, reverse=True):
        # Others may close it meanwhile.
        with suppress(OSError):
            if stat.S_ISSOCK(os.fstat(number).st_mode) and _turned_off(number, (own_port, their_port)):
                return True
    return False


def _turned_off(number: int, ports: tuple[int, int]) -> bool:
    """Whether an open file was the connection between these ports.

    Raises:
        OSError: it is no socket, or none that is connected.
    """
    # Under one more number: closing that leaves zenoh's open.
    another = os.dup(number)
    try:
        connection = socket.socket(fileno=another)
    except OSError:
        os.close(another)
        raise
    with connection:
        if _ports(connection) != ports:
            return False
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
        return True


def _ports(connection: socket.socket) -> tuple[int, int] | None:
    """The ports of both ends; None if it has none.

    Raises:
        OSError: it is not connected.
    """
    if connection.family not in (socket.AF_INET, socket.AF_INET6):
        return None
    return connection.getsockname()[1], connection.getpeername()[1]


def _port(locator: str) -> int | None:
    """The port of a locator such as `tls/[::1]:7447#option=1`; None if it has none."""
    port = locator.partition("#")[0].partition("?")[0].rpartition(":")[2]
    return int(port) if port.isdigit() else None

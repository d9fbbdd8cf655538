"""What a server tells about its lane, and where a client can take it: only on the server's machine."""

import os
import platform
import socket
import uuid
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from struct import Struct
from typing import Any, Final, NamedTuple

UNIX: Final = hasattr(socket, "AF_UNIX")
"""Whether this platform has unix sockets in Python."""

_CONNECT_S: Final = 1.0

_CREDENTIALS: Final = Struct("3i")
"""Linux's `ucred`: process, user, group."""

EXPECTED: Final = "expected unix:PATH, or tcp:127.0.0.1:PORT (loopback only)"


class LaneOffer(NamedTuple):
    """A server's lane, as its metadata tell it.

    Attributes:
        address: `unix:PATH` or `tcp:HOST:PORT`.
        machine: the server's `machine_identity`.
        extensions: what it understands beyond requests, such as `cancel`.
    """

    address: str
    machine: str
    extensions: tuple[str, ...] = ()

    @classmethod
    def read(cls, metadata: Any) -> "LaneOffer | None":
        """The offer in a server's metadata; None if there is none, or none that can be understood."""
        told = metadata.get("lane") if isinstance(metadata, dict) else None
        if not isinstance(told, dict):
            return None
        address, machine, extensions = told.get("address"), told.get("machine"), told.get("extensions")
        if not (isinstance(address, str) and isinstance(machine, str)):
            return None
        names = extensions if isinstance(extensions, (list, tuple)) else ()
        return cls(address, machine, tuple(name for name in names if isinstance(name, str)))


def parse_address(address: str) -> Path | tuple[str, int]:
    """The path of `unix:PATH`, or the host and port of `tcp:HOST:PORT`.

    Raises:
        ValueError: it is neither, or the host is not this machine.
    """
    kind, _, place = address.partition(":")
    if kind == "unix" and place:
        return Path(place)
    host, _, port = place.rpartition(":")
    try:
        if kind == "tcp" and ip_address(host).is_loopback and 0 <= int(port) < 65_536:
            return host, int(port)
    except ValueError:
        pass
    raise ValueError(f"{address!r}: {EXPECTED}")


def connect_to(address: str) -> socket.socket:
    """A blocking connection to a lane.

    Raises:
        ValueError: that is no address of a lane.
        OSError: nobody listens there, or the listener belongs to another user.
    """
    place = parse_address(address)
    if isinstance(place, tuple):
        connection = socket.create_connection(place, _CONNECT_S)
        connection.settimeout(None)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection
    if not UNIX:
        raise OSError(f"{address}: this platform has no unix sockets")
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        # A listener with a full backlog must not hold up its callers.
        connection.settimeout(_CONNECT_S)
        connection.connect(str(place))
        connection.settimeout(None)
        if not of_this_user(connection):
            raise PermissionError(f"{address}: another user listens there")
    except OSError:
        connection.close()
        raise
    return connection


def of_this_user(connection: socket.socket) -> bool:
    """Whether the other end of a unix socket belongs to this user, or to root.

    Where the system does not tell, the file's permissions decide.
    """
    if not hasattr(socket, "SO_PEERCRED"):
        return True
    _, user = _peer(connection)
    return user in (os.geteuid(), 0)


def process_of(client: socket.socket) -> int | None:
    """The process at the other end of a unix socket; None where the system does not tell."""
    if client.family != getattr(socket, "AF_UNIX", None) or not hasattr(socket, "SO_PEERCRED"):
        return None
    return _peer(client)[0]


def name_of(client: socket.socket) -> str:
    """What a client of a lane is called in logs: its process or its port, or `lane` if neither is known."""
    if client.family in (socket.AF_INET, socket.AF_INET6):
        with suppress(OSError):
            host, port = client.getpeername()[:2]
            return f"{host}:{port}"
    elif hasattr(socket, "SO_PEERCRED"):
        return f"pid {_peer(client)[0]}"
    return "lane"


def _peer(connection: socket.socket) -> tuple[int, int]:
    """Process and user of the other end of a unix socket; Linux only."""
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    process, user, _ = _CREDENTIALS.unpack(credentials)
    return process, user


def machine_identity() -> str:
    """The same for two processes that reach each other by a path or a loopback port, and else different.

    On Linux: the boot, the machine and the network namespace, which containers have of their own.
    """
    if platform.system() != "Linux":
        return f"{platform.node()}:{uuid.getnode():x}"
    parts = []
    for file in ("/proc/sys/kernel/random/boot_id", "/etc/machine-id"):
        with suppress(OSError):
            parts.append(Path(file).read_text(encoding="ascii").strip())
    with suppress(OSError):
        parts.append(str(Path("/proc/self/ns/net").readlink()))
    return ":".join(parts)

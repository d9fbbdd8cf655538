"""The socket that the lane listens on: a file that only this user may open, or a loopback port."""

import errno
import os
import socket
import stat
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Final

from taxel.errors import TaxelError
from taxel.lane.offer import UNIX, parse_address

_BACKLOG: Final = 128
_LONGEST_PATH: Final = 103
"""Bytes of the path of a unix socket; Linux allows 107, macOS 103."""


class LaneSocket:
    """Listens on an address from construction until `close`.

    Args:
        address: `unix:PATH` or `tcp:HOST:PORT`; port 0 is any free one.

    Attributes:
        address: for clients, with the whole path or the port.

    Raises:
        TaxelError: it cannot be listened on, as another server does so already.
    """

    def __init__(self, address: str) -> None:
        place = parse_address(address)
        if isinstance(place, Path):
            # Clients have other working directories.
            place = place.absolute()
        try:
            self.socket = _bound_to_port(place) if isinstance(place, tuple) else _bound_to_file(place)
            self.socket.listen(_BACKLOG)
        except OSError as error:
            raise TaxelError(f"cannot listen on {address}: {error.strerror or error}") from None
        self.socket.setblocking(False)
        if isinstance(place, tuple):
            self.address = f"tcp:{place[0]}:{self.socket.getsockname()[1]}"
        else:
            self.address = f"unix:{place}"
        self._path = place if isinstance(place, Path) else None
        self._inode = self._path.stat().st_ino if self._path else 0

    def close(self) -> None:
        """Stop listening, and remove the file, unless another server has put its own there."""
        self.socket.close()
        if self._path is not None:
            with suppress(OSError):
                if self._path.stat().st_ino == self._inode:
                    self._path.unlink()


def automatic_address(endpoints: Sequence[str]) -> str:
    """Where the lane listens if no address is set: a file in the user's runtime folder.

    The same endpoints give the same file, so that clients find a server again that was restarted. Where
    Python has no unix sockets it is a free loopback port.

    Args:
        endpoints: where the server listens with zenoh.

    Raises:
        TaxelError: the folder cannot be made, or others may write to it.
    """
    if not UNIX:
        return "tcp:127.0.0.1:0"
    name = sha256(",".join(endpoints).encode()).hexdigest()[:16]
    return f"unix:{_runtime_folder() / name}.sock"


def _runtime_folder() -> Path:
    """A folder that only this user may enter."""
    user = os.geteuid()
    candidates = (Path(os.environ.get("XDG_RUNTIME_DIR", "")), Path(f"/run/user/{user}"))
    above = next((folder for folder in candidates if _is_for_runtime(folder, user)), None)
    folder = above / "taxel" if above else Path(tempfile.gettempdir(), f"taxel-{user}")
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise TaxelError(f"cannot make {folder}: {error.strerror}") from None
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != user or found.st_mode & 0o077:
        raise TaxelError(f"{folder}: expected a folder of this user that nobody else may enter")
    return folder


def _is_for_runtime(folder: Path, user: int) -> bool:
    """Whether this user owns a folder and may write there: another owner could replace what lies in it."""
    with suppress(OSError):
        return folder.is_absolute() and folder.stat().st_uid == user and os.access(folder, os.W_OK)
    return False


def _bound_to_port(place: tuple[str, int]) -> socket.socket:
    listener = socket.socket(socket.AF_INET6 if ":" in place[0] else socket.AF_INET)
    try:
        if os.name == "posix":
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(place)
    except OSError:
        listener.close()
        raise
    return listener


def _bound_to_file(path: Path) -> socket.socket:
    if not UNIX:
        raise OSError(errno.EAFNOSUPPORT, "this platform has no unix sockets: expected tcp:127.0.0.1:PORT")
    if len(os.fsencode(path)) > _LONGEST_PATH:
        raise OSError(errno.ENAMETOOLONG, f"expected an absolute path of at most {_LONGEST_PATH} bytes")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        _remove_abandoned(path)
        listener.bind(str(path))
        # Nobody can connect before `listen`, so nobody connects before this.
        path.chmod(0o600)
    except OSError:
        listener.close()
        raise
    return listener


def _remove_abandoned(path: Path) -> None:
    """Remove a socket's file that a server left behind which was killed."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise OSError(errno.EEXIST, "the file exists, and is no socket")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
        except BlockingIOError:
            raise OSError(errno.EADDRINUSE, "another server listens there") from None
        else:
            raise OSError(errno.EADDRINUSE, "another server listens there")

"""Files that others have put into a folder: each is looked at before a byte of it is read.

A repository may come from anyone. Reading a FIFO never ends, nor does reading `/dev/zero`. A link may
name any file of the machine.
"""

import os
import stat
from io import BufferedReader
from pathlib import Path
from typing import Final

from taxel.errors import ArtifactError

_KINDS: Final = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def open_contained(path: Path, *, inside: Path, most_bytes: int) -> BufferedReader:
    """Open an ordinary file for reading; never waits.

    Args:
        path: the file. It may be a link, or lie behind one.
        inside: the folder that every link has to stay in.
        most_bytes: the largest size that is accepted.

    Raises:
        ArtifactError: it does not exist, lies elsewhere, is no ordinary file, or is too large.
    """
    try:
        place = path.resolve(strict=True)
        if not place.is_relative_to(inside.resolve(strict=True)):
            raise ArtifactError(f"{path}: a link to {place}: expected a file inside {inside}")
        # Opening a device may already have an effect.
        _check_ordinary(path, place.lstat())
        flags = ("O_RDONLY", "O_BINARY", "O_CLOEXEC", "O_NOFOLLOW", "O_NONBLOCK")
        descriptor = os.open(place, sum(getattr(os, flag, 0) for flag in flags))
        file = os.fdopen(descriptor, "rb")
    except RuntimeError:  # what Python before 3.13 raises for links in a circle
        raise ArtifactError(f"{path}: its links form a circle") from None
    except OSError as error:
        raise ArtifactError(f"{path}: {error.strerror or error}") from None
    try:
        found = os.fstat(file.fileno())
        # Between the two looks, something else may have come to lie there.
        _check_ordinary(path, found)
        if found.st_size > most_bytes:
            raise ArtifactError(f"{path}: {found.st_size} bytes: expected at most {most_bytes}")
    except BaseException:
        file.close()
        raise
    return file


def _check_ordinary(path: Path, found: os.stat_result) -> None:
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "something else")
        raise ArtifactError(f"{path}: {kind}: expected an ordinary file")

"""Which processes listen on a TCP port, from Linux's /proc."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

_TABLES: Final = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))

_LISTENING: Final = "0A"
"""The state of a socket that listens, in the tables."""

_LONGEST: Final = 80
"""Characters of a command line that are told."""


def listeners_on(port: int) -> list[str] | None:
    """The processes that listen on a port, as `PID COMMAND`; None where the system does not tell.

    A process of another user is told as `another user's process`, unless root asks.
    """
    if not _TABLES[0].exists():
        return None
    wanted = {f"socket:[{inode}]" for table in _TABLES for inode in _inodes(table, port)}
    if not wanted:
        return []
    found = dict(_processes_with(wanted))
    return [f"{process} {command}" for process, command in found.items()] or ["another user's process"]


def _inodes(table: Path, port: int) -> Iterator[str]:
    with suppress(OSError):
        for line in table.read_text(encoding="ascii").splitlines()[1:]:
            fields = line.split()
            if fields[3] == _LISTENING and int(fields[1].rpartition(":")[2], 16) == port:
                yield fields[9]


def _processes_with(wanted: set[str]) -> Iterator[tuple[int, str]]:
    for folder in Path("/proc").glob("[0-9]*"):
        # Processes end meanwhile, and those of others may not be looked into.
        with suppress(OSError):
            for descriptor in (folder / "fd").iterdir():
                with suppress(OSError):
                    if str(descriptor.readlink()) in wanted:
                        yield int(folder.name), _command(folder)


def _command(folder: Path) -> str:
    words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
    return " ".join(words).strip()[:_LONGEST] or (folder / "comm").read_text(encoding="utf-8").strip()

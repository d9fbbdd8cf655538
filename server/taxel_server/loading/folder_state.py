"""Whether an artifact's folder has changed, without opening a file."""

import os
from pathlib import Path

FolderState = tuple[tuple[str, int, int, int], ...]
"""Of each file: its name, size, time of change in ns, and inode."""


def folder_state(folder: Path) -> FolderState:
    """What the system tells about a folder's files; empty if it cannot be read."""
    try:
        with os.scandir(folder) as entries:
            found = [(entry.name, entry.stat(follow_symlinks=False)) for entry in entries]
    except OSError:
        return ()
    return tuple(sorted((name, of.st_size, of.st_mtime_ns, of.st_ino) for name, of in found))

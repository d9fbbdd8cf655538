"""Keeps numba's cache from giving code of another version.

Numba compiles a cached function again when its own file has changed, but not when a file has that it
calls into. What is added here goes into the names of numba's files: a fingerprint of all that may be
called.
"""

import hashlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TypeVar

_RUNTIMES: Final = Path(__file__).parent.parent

_Function = TypeVar("_Function", bound=Callable[..., Any])


def fingerprint(folder: Path) -> str:
    """Of all Python files below a folder: names and content."""
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        total.update(f"{path.relative_to(folder)}:{path.stat().st_size}:".encode())
        total.update(path.read_bytes())
    return total.hexdigest()


def forget(folder: Path, kept: str) -> None:
    """Removes what numba keeps beside the code below a folder, but for files with a fingerprint."""
    for path in folder.rglob("__pycache__/*.nb[ic]"):
        if f"-{kept}-" not in path.name:
            # Another process may be first, or the folder may be another user's.
            with suppress(OSError):
                path.unlink()


_FINGERPRINT: Final = fingerprint(_RUNTIMES)[:16]
forget(_RUNTIMES, _FINGERPRINT)


def fresh(function: _Function) -> _Function:
    """A function, about to be compiled, that the cache gives only as long as no runtime's file changes.

    Numba names a function's files after it. A file of another version is not even opened: it may refer
    to types that are gone.
    """
    function.__qualname__ += f"-{_FINGERPRINT}"
    return function

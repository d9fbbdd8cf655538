"""Compiles functions with numba and caches the code for other processes.

Numba compiles a cached function again if its own file has changed, but not if another file that it calls
has changed. So each state of the code has another cache folder: the folder's name holds a fingerprint of
all files that may be called.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar, cast

import numba

from taxel import __version__

_RUNTIMES: Final = Path(__file__).parent.parent

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


def fingerprint(folder: Path) -> str:
    """The fingerprint of the Python files below a folder, and of the versions of Taxel and numba."""
    total = hashlib.sha256(f"{__version__} {numba.__version__}".encode())
    for path in sorted(folder.rglob("*.py")):
        total.update(f"{path.relative_to(folder)}:{path.stat().st_size}:".encode())
        total.update(path.read_bytes())
    return total.hexdigest()[:16]


@cache
def cache_folder() -> Path | None:
    """The folder of compiled code: below `NUMBA_CACHE_DIR`, or else in the user's cache folder.

    None if nothing can be written there. Then every process compiles again.
    """
    user = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    parent = Path(numba.config.CACHE_DIR or Path(user) / "taxel")
    folder = parent / f"compiled-{fingerprint(_RUNTIMES)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return None


def compiled(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Compiles a function for the types of its arguments and caches the code. It releases the GIL."""
    with _caching() as caching:
        result = numba.njit(cache=caching, nogil=True)(function)
    return cast("Callable[_Given, _Result]", result)


def inlined(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Makes a function part of each compiled function that calls it."""
    return cast("Callable[_Given, _Result]", numba.njit(inline="always")(function))


def address_of(signature: str) -> Callable[[Callable[..., Any]], int]:
    """Compiles a function at once for a signature in numba's notation, and gives its address."""

    def compile_now(function: Callable[..., Any]) -> int:
        with _caching() as caching:
            return int(numba.cfunc(signature, cache=caching)(function).address)

    return compile_now


@contextmanager
def _caching() -> Iterator[bool]:
    """Sets numba's cache folder while a function is decorated: numba reads it only then."""
    folder, before = cache_folder(), numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder or "")
    try:
        yield folder is not None
    finally:
        numba.config.CACHE_DIR = before

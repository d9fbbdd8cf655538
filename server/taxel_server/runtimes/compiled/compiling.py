"""Compiles functions with numba, and keeps what was compiled between processes.

Numba compiles a cached function again when its own file has changed, but not when a file has changed
that it calls into. So the cache has a folder of its own for each state of the code: the folder's name
holds a fingerprint of all the files that may be called.
"""

import hashlib
import logging
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from threading import RLock
from typing import Any, Final, ParamSpec, TypeVar, cast

import numba

from taxel import __version__

_LOG: Final = logging.getLogger(__name__)

_RUNTIMES: Final = Path(__file__).parent.parent

_ROOM: Final = 2**24
"""Bytes that must fit where compiled code is kept, with what is there already: numba fails if they do not.
All code of a version takes half as many."""

_LEAST_ROOM: Final = 2**16
"""Bytes that must fit in any case."""

_DECORATING: Final = RLock()
"""Held while numba's setting is changed: several threads may load models."""

_ANY_ORDER: Final = {"reassoc", "contract"}

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


def fingerprint(folder: Path) -> str:
    """Of the versions of Taxel and numba, and of the Python files below a folder: names and content."""
    total = hashlib.sha256(f"{__version__} {numba.__version__}".encode())
    for path in sorted(folder.rglob("*.py")):
        total.update(f"{path.relative_to(folder)}:{path.stat().st_size}:".encode())
        total.update(path.read_bytes())
    return total.hexdigest()[:16]


@cache
def cache_folder() -> Path | None:
    """Where compiled code is kept: below `NUMBA_CACHE_DIR`, or else in the user's cache folder.

    None if nothing can be written there, or if the user has no home: then every process compiles for
    itself.
    """
    try:
        folder = _cache_parent() / f"compiled-{fingerprint(_RUNTIMES)}"
        folder.mkdir(parents=True, exist_ok=True)
        kept = sum(path.stat().st_size for path in folder.rglob("*.nb?"))
        with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
            file.write(bytes(_LEAST_ROOM))
            if sys.platform == "linux":
                os.posix_fallocate(file.fileno(), 0, max(_ROOM - kept, _LEAST_ROOM))
    except (OSError, RuntimeError):
        return None
    return folder


def _cache_parent() -> Path:
    """The folder of the cache folders.

    Raises:
        RuntimeError: the user has no home, as in a container that runs as a user it does not know.
    """
    if numba.config.CACHE_DIR:
        return Path(numba.config.CACHE_DIR)
    user = os.environ.get("XDG_CACHE_HOME")
    return (Path(user) if user else Path.home() / ".cache") / "taxel"


def _named_parent() -> str:
    try:
        return str(_cache_parent())
    except RuntimeError:
        return "a home folder"


@cache
def announce() -> None:
    """Tell whoever is about to wait for a compilation: once in a process, in the log."""
    folder = cache_folder()
    if folder is None:
        _LOG.warning(
            "nothing can be kept in %s, or its disk is full: every start compiles, for about half a minute",
            _named_parent(),
        )
    elif next(folder.rglob("*.nbc"), None) is None:
        _LOG.warning("the first start of this version compiles, for about half a minute")


def compiled(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Compiles a function for the types that it is called with, and keeps the code; it releases the GIL."""
    with _caching() as caching:
        result = numba.njit(cache=caching, nogil=True)(function)
    return cast("Callable[_Given, _Result]", result)


def inlined(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Makes a function part of each compiled function that calls it."""
    return cast("Callable[_Given, _Result]", numba.njit(inline="always")(function))


def strict(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Compiles a function whose order of operations counts. A division by 0 raises no error."""
    return cast("Callable[_Given, _Result]", numba.njit(error_model="numpy")(function))


def any_order(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Compiles a function whose sums may have any order: LLVM then adds a register of values at once."""
    return cast("Callable[_Given, _Result]", numba.njit(error_model="numpy", fastmath=_ANY_ORDER)(function))


def address_of(signature: str) -> Callable[[Callable[..., Any]], int]:
    """Compiles a function at once, for a signature in numba's words; gives its address."""

    def compile_now(function: Callable[..., Any]) -> int:
        with _caching() as caching:
            return int(numba.cfunc(signature, cache=caching)(function).address)

    return compile_now


@contextmanager
def _caching() -> Iterator[bool]:
    """Sets numba's cache folder while a function is decorated: that is when numba looks where it is."""
    with _DECORATING:
        folder, before = cache_folder(), numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(folder or "")
        try:
            yield folder is not None
        finally:
            numba.config.CACHE_DIR = before

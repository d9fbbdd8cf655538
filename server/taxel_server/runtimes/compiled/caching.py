"""Keeps numba's cache from giving code of another version.

Numba compiles a cached function again when its own file has changed, but not when a file has that it
calls into. What is added here is part of numba's key: a fingerprint of all files that may be called.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from types import CellType, FunctionType
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


_FINGERPRINT: Final = fingerprint(_RUNTIMES)


def fresh(function: _Function) -> _Function:
    """A function, about to be compiled, that the cache gives only as long as no runtime's file changes.

    Numba's key has a hash of what a function closes over: it closes over the fingerprint, too.
    """
    assert isinstance(function, FunctionType)
    code = function.__code__
    closure = (*(function.__closure__ or ()), CellType(_FINGERPRINT))
    closing = code.replace(co_freevars=(*code.co_freevars, "_fingerprint"))
    result = FunctionType(closing, function.__globals__, function.__name__, function.__defaults__, closure)
    result.__qualname__, result.__doc__ = function.__qualname__, function.__doc__
    result.__module__ = function.__module__
    return result  # type: ignore[return-value]

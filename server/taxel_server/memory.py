"""The process's memory: what the allocator holds without need goes back to the system."""

import ctypes
import os
import sys
from typing import Final

_ARENA_MAX: Final = -8
"""glibc's number of the option that `mallopt` sets."""

_ARENAS: Final = 2

_REQUEST_BYTES: Final = 1024
"""Of a request, besides what arrived."""

_IDLE_S: Final = 1.0


def limit_arenas() -> None:
    """Let all threads allocate from two arenas, where it is glibc; call it before threads start.

    glibc would give nearly each thread of zenoh an arena of its own. What a flood leaves in use in each of
    them keeps memory (docs/results/chaos). The environment variable MALLOC_ARENA_MAX decides if it is set.
    """
    if sys.platform == "linux" and "MALLOC_ARENA_MAX" not in os.environ:
        library = ctypes.CDLL(None)
        if hasattr(library, "gnu_get_libc_version"):
            library.mallopt(_ARENA_MAX, _ARENAS)


def give_back() -> None:
    """Give the allocator's free pages back, where it is glibc, which keeps them by itself.

    It takes milliseconds.
    """
    if sys.platform == "linux" and hasattr(library := ctypes.CDLL(None), "malloc_trim"):
        library.malloc_trim(0)


class FreeMemory:
    """Notes what was handled; gives free memory back when it is idle after much work."""

    MUCH_BYTES: Final = 8 * 2**20
    """Requests of so many bytes may have left memory behind."""

    def __init__(self) -> None:
        self._handled = 0

    def note(self, size: int) -> None:
        """A request of so many bytes has arrived."""
        self._handled += size + _REQUEST_BYTES

    @property
    def idle_s(self) -> float | None:
        """After how many seconds without work `release` is to be called; None if there is no need."""
        return _IDLE_S if self._handled > self.MUCH_BYTES else None

    def release(self) -> None:
        """Give back the pages that lie, after a flood, between small blocks that are in use."""
        self._handled = 0
        give_back()

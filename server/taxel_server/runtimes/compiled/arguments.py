"""Packs many arrays into one argument of a compiled function: each further argument costs call time."""

import mmap
from typing import Any, Final

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numpy.typing import NDArray

from taxel_server.runtimes.compiled.compiling import inlined
from taxel_server.runtimes.compiled.vectors import operation

_CACHE_LINE: Final = 64
_HUGE_PAGE: Final = 2**21


def pack(*tuples: tuple[Any, ...]) -> NDArray[np.int64]:
    """Two integers for every entry: an array's address and size, or a number and 0.

    The arrays must be contiguous. The result does not keep them alive. `array_in` and `number_in` read it.
    """
    entries = []
    for entry in (entry for entries in tuples for entry in entries):
        if isinstance(entry, np.ndarray):
            if not entry.flags.c_contiguous:
                raise ValueError(f"a kernel's arrays must be contiguous: found strides {entry.strides}")
            entries.append((entry.ctypes.data, entry.size))
        else:
            entries.append((int(entry), 0))
    return np.array(entries, dtype=np.int64)


def together(*arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """Copies of arrays in one block of memory; each starts at a cache line.

    Large blocks use huge pages if the system has them: with fewer pages, memory is read faster.
    """
    starts = np.cumsum([0, *(-(-array.nbytes // _CACHE_LINE) * _CACHE_LINE for array in arrays)])
    block = _block(int(starts[-1]))
    copies = []
    for start, array in zip(starts, arrays, strict=False):
        copy = block[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
        copy[...] = array
        copies.append(copy)
    return copies


def _block(size: int) -> NDArray[np.uint8]:
    """Memory that starts at a cache line. A large block gets new pages: only these become huge pages."""
    if size < _HUGE_PAGE or not hasattr(mmap, "MADV_HUGEPAGE"):
        block = np.empty(size + _CACHE_LINE, dtype=np.uint8)
        return block[-block.ctypes.data % _CACHE_LINE :]
    memory = mmap.mmap(-1, size + 2 * _HUGE_PAGE, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    memory.madvise(mmap.MADV_HUGEPAGE)
    block = np.frombuffer(memory, dtype=np.uint8)
    return block[-block.ctypes.data % _HUGE_PAGE :]


class Scratch:
    """Copies of the arrays that a kernel writes to, packed as its arguments; for one call at a time."""

    def __init__(self, arrays: tuple[Any, ...]) -> None:
        self._kept = together(*arrays)
        self.arguments = pack(tuple(self._kept))


@operation
def _pointer(_context: Any, _address: Any) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        return builder.inttoptr(given[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), generate


@inlined
def array_in(arguments: NDArray[np.int64], entry: int, dtype: Any) -> Any:
    """The array of one axis that an entry describes; in compiled code."""
    return numba.carray(_pointer(arguments[entry, 0]), arguments[entry, 1], dtype)


@inlined
def number_in(arguments: NDArray[np.int64], entry: int) -> Any:
    """The number in an entry; in compiled code."""
    return arguments[entry, 0]

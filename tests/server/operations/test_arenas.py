"""The server's threads share arenas of glibc's allocator, so that a flood leaves no memory behind."""

import ctypes
import os
import subprocess
import sys

import pytest

_ALLOCATE = """
import ctypes, sys
from threading import Barrier, Thread
from taxel_server.memory import limit_arenas

if sys.argv[1] == "limited":
    limit_arenas()
library = ctypes.CDLL(None)
library.malloc.restype = ctypes.c_void_p
library.malloc.argtypes = [ctypes.c_size_t]
together = Barrier(8)

def allocate():
    together.wait()
    library.malloc(4000)
    together.wait()

threads = [Thread(target=allocate) for _ in range(8)]
for each in threads:
    each.start()
for each in threads:
    each.join()
library.fopen.restype = ctypes.c_void_p
library.malloc_info.argtypes = [ctypes.c_int, ctypes.c_void_p]
library.fflush.argtypes = [ctypes.c_void_p]
stdout = library.fopen(b"/dev/stdout", b"w")
library.malloc_info(0, stdout)
library.fflush(stdout)
"""


def arenas(how: str, **environment: str) -> int:
    kept = {name: value for name, value in os.environ.items() if name != "MALLOC_ARENA_MAX"}
    told = subprocess.run(
        [sys.executable, "-c", _ALLOCATE, how],
        env=kept | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return told.stdout.count("<heap nr=")


@pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "malloc_info"), reason="glibc's alone"
)
def test_threads_share_two_arenas_unless_the_user_says_otherwise() -> None:
    assert arenas("unlimited") > 3
    assert arenas("limited") == 2
    assert arenas("limited", MALLOC_ARENA_MAX="3") == 3

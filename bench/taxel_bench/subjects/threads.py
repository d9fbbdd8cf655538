"""One thread for every engine, so that they are compared like with like."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

from taxel_bench.engines import THREADS


@contextmanager
def pinned_threads() -> Iterator[None]:
    """Torch, and every library of OpenMP or BLAS, computes with one thread while the block lasts.

    It holds for the libraries that are loaded when the block begins.
    """
    torch = sys.modules.get("torch")
    before = None if torch is None else torch.get_num_threads()
    if torch is not None:
        torch.set_num_threads(THREADS)
    try:
        with threadpool_limits(THREADS):
            yield
    finally:
        if torch is not None:
            torch.set_num_threads(before)

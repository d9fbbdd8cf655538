"""What every client program does: obeys one line of JSON after another on stdin, answers on stdout.

    {"do": "answer", "rows": n}                          -> {"counts": n x 21 numbers}
    {"do": "sequential", "rows": n, "seconds": s, "gap_ms": g}
                                                         -> {"queries": q, "latencies": q times, seconds}
    {"do": "in_flight", "at_once": n, "seconds": s}      -> {"queries": q, "seconds": from first to last}

A gap, 0 unless given, is the pause between an answer and the next query. Encoding windows and decoding
counts is part of what is timed.
"""

import argparse
import gc
import json
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from itertools import cycle, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

_CHANNELS = 21
_WARM_UP = 20


class Client(ABC):
    """A connection to one server."""

    @abstractmethod
    def connect(self, at_once: int) -> None:
        """Get ready for so many queries at once; not timed.

        Between two orders a server may have closed connections that nobody used.
        """

    @abstractmethod
    def ask(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Send windows (n, f) and wait for their counts (n, 21)."""

    @abstractmethod
    def ask_many(self, queries: Iterator[NDArray[np.float32]], at_once: int) -> int:
        """Send every query, so many at once, and wait for all answers; how many there were.

        Args:
            queries: windows of one query each.
            at_once: as many as `connect` was told.
        """


def counts_of(body: bytes) -> NDArray[np.float32]:
    """Counts (n, 21) from a peer's raw bytes."""
    return np.frombuffer(body, "<f4").reshape(-1, _CHANNELS)


def client_arguments() -> argparse.ArgumentParser:
    """Reads what a client is told: a server's address and port, and a file of windows (m, f) float32."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--address", required=True)
    parser.add_argument("--port", required=True, type=int)
    parser.add_argument("--windows", required=True)
    return parser


def obey(client: Client, windows_file: str) -> None:
    """Do what stdin says until it ends."""
    windows = np.load(windows_file)
    orders: dict[str, Callable[..., dict[str, Any]]] = {
        "answer": _answer,
        "sequential": _sequential,
        "in_flight": _in_flight,
    }
    gc.disable()
    for line in sys.stdin:
        order: dict[str, Any] = json.loads(line)
        result = orders[order.pop("do")](client, windows, **order)
        sys.stdout.write(json.dumps(result) + "\n")
        sys.stdout.flush()
        gc.collect()


def _answer(client: Client, windows: NDArray[np.float32], rows: int) -> dict[str, Any]:
    client.connect(1)
    return {"counts": client.ask(windows[:rows]).tolist()}


def _sequential(
    client: Client, windows: NDArray[np.float32], rows: int, seconds: float, gap_ms: float = 0
) -> dict[str, Any]:
    queries = _queries(windows, rows)
    client.connect(1)
    for query in islice(queries, _WARM_UP):
        client.ask(query)
    latencies: list[float] = []
    until = time.perf_counter() + seconds
    while (start := time.perf_counter()) < until:
        client.ask(next(queries))
        latencies.append(time.perf_counter() - start)
        if gap_ms:
            time.sleep(gap_ms / 1e3)
    return {"queries": len(latencies), "latencies": latencies}


def _in_flight(
    client: Client, windows: NDArray[np.float32], at_once: int, seconds: float
) -> dict[str, Any]:
    client.connect(at_once)
    start = time.perf_counter()
    until = start + seconds
    answered = client.ask_many(_while_before(until, _queries(windows, 1)), at_once)
    return {"queries": answered, "seconds": time.perf_counter() - start}


def _while_before(until: float, queries: Iterator[NDArray[np.float32]]) -> Iterator[NDArray[np.float32]]:
    """Queries until a moment of the clock `time.perf_counter`."""
    for query in queries:
        if time.perf_counter() >= until:
            return
        yield query


def _queries(windows: NDArray[np.float32], rows: int) -> Iterator[NDArray[np.float32]]:
    """Windows of one query after another, again and again from the start."""
    firsts = range(0, len(windows) - rows + 1, rows)
    return cycle([windows[first : first + rows] for first in firsts])

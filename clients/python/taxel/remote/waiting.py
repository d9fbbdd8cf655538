"""How the core waits. The synchronous face waits in the call, the asynchronous one in its event loop.

The core's coroutines wait for nothing else. So those of the synchronous face never suspend, and `finished`
runs them.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Coroutine
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.lane.client import Lane
from taxel.lane.frames import ReplyHead
from taxel.lane.lookup import LaneT
from taxel.remote.query_transport import QueryTransport

T = TypeVar("T")

Reply = tuple[ReplyHead, list[NDArray[np.float32]]]
"""The head of a lane's reply, and the counts (n, 21), followed by the spread if it was asked for."""


class Waiting(ABC, Generic[LaneT]):
    """How a face waits."""

    @abstractmethod
    async def ask(
        self,
        transport: QueryTransport,
        key: str,
        payload: bytes | None,
        timeout: float,
        cancel_key: str | None = None,
    ) -> bytes:
        """The answer to a query; arguments and errors as in `QueryTransport.start`."""

    @abstractmethod
    async def open_lane(self, address: str, extensions: tuple[str, ...]) -> LaneT:
        """The client's end of a lane; raises OSError or ValueError if it cannot be opened."""

    @abstractmethod
    async def ask_lane(
        self,
        lane: LaneT,
        path: str,
        windows: NDArray[np.float32],
        timeout: float,
        wait: float,
        spread: bool,
        traceparent: str | None,
    ) -> Reply:
        """The reply on a lane; arguments and errors as in `Lane.infer`."""

    @abstractmethod
    async def sleep(self, seconds: float) -> None:
        """Wait."""


def finished(coroutine: Coroutine[Any, Any, T]) -> T:
    """The result of a coroutine that never suspends."""
    try:
        coroutine.send(None)
    except StopIteration as done:
        result: T = done.value
        return result
    coroutine.close()
    raise AssertionError("a call that waits by itself was suspended")


class BlockingCalls(Waiting[Lane]):
    """Each call waits in its own thread.

    Args:
        spin_us: as in `Lane`.
    """

    def __init__(self, spin_us: int) -> None:
        self._spin_us = spin_us

    @override
    async def ask(
        self,
        transport: QueryTransport,
        key: str,
        payload: bytes | None,
        timeout: float,
        cancel_key: str | None = None,
    ) -> bytes:
        return transport.start(key, payload, timeout, cancel_key)()

    @override
    async def open_lane(self, address: str, extensions: tuple[str, ...]) -> Lane:
        return Lane(address, self._spin_us, extensions)

    @override
    async def ask_lane(
        self,
        lane: Lane,
        path: str,
        windows: NDArray[np.float32],
        timeout: float,
        wait: float,
        spread: bool,
        traceparent: str | None,
    ) -> Reply:
        return lane.infer(path, windows, timeout, wait, spread=spread, traceparent=traceparent)

    @override
    async def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

"""How the asynchronous face waits: in its event loop, with no thread for a call."""

import asyncio
import time
from asyncio import AbstractEventLoop
from contextlib import suppress
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.errors import DeadlineExceeded, RequestError
from taxel.lane.async_client import AsyncLane
from taxel.lane.prompt_future import PromptFuture
from taxel.polling import PollingInLoop, give_way
from taxel.remote.query_transport import Polled, QueryTransport
from taxel.remote.waiting import Reply, Waiting

_PATIENCE_S: Final = 1.0
"""How much longer than a query's timeout its transport may take to tell that it has passed."""

_POLL_S: Final = 2e-4
"""A lone query's answer is looked for again and again for so long before the loop turns."""

_QUICK_S: Final = 4e-4
"""Where the last answer took longer, the next one is not looked for in this way."""

_LOOK_AGAIN_S: Final = 1e-3
"""How often it is looked for after that."""


class AwaitedCalls(Waiting[AsyncLane]):
    """All calls wait in one event loop.

    Args:
        loop: the running loop.
    """

    def __init__(self, loop: AbstractEventLoop) -> None:
        self._loop = loop
        self._polling = PollingInLoop(loop, _QUICK_S)
        self._waiting = 0

    @override
    async def ask(
        self,
        transport: QueryTransport,
        key: str,
        payload: bytes | None,
        timeout: float,
        cancel_key: str | None = None,
    ) -> bytes:
        began = time.monotonic()
        alone = not self._waiting and self._polling.is_quick
        polled = transport.start_polled(key, payload, timeout, cancel_key) if alone else None
        self._waiting += 1
        try:
            if polled is not None:
                return await self._looked_for(polled, began)
            return await self._called_back(transport, key, payload, timeout, cancel_key)
        finally:
            self._waiting -= 1
            self._polling.note(time.monotonic() - began)

    async def _looked_for(self, polled: Polled, began: float) -> bytes:
        try:
            if not self._polling.may_poll(began):
                # Other tasks have a turn; the server works meanwhile.
                await asyncio.sleep(0)
            while (answer := polled.look()) is None:
                if time.monotonic() < began + _POLL_S:
                    give_way()
                else:
                    await asyncio.sleep(_LOOK_AGAIN_S)
        except asyncio.CancelledError:
            polled.give_up()
            raise
        return answer

    async def _called_back(
        self,
        transport: QueryTransport,
        key: str,
        payload: bytes | None,
        timeout: float,
        cancel_key: str | None,
    ) -> bytes:
        answer: PromptFuture[bytes] = PromptFuture(loop=self._loop)

        def settle(outcome: bytes | RequestError) -> None:
            # A call that was cancelled or is late does not wait any more.
            if isinstance(outcome, RequestError):
                if not answer.done():
                    answer.set_exception(outcome)
            else:
                answer.settle(outcome)

        def done(outcome: bytes | RequestError) -> None:
            # The loop may be closed by now.
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(settle, outcome)

        def late() -> None:
            settle(DeadlineExceeded(f"{transport.endpoint}: no answer to {key} within {timeout:g} s"))

        ends = self._loop.time() + timeout
        give_up = transport.send(key, payload, timeout, done, cancel_key)
        timer = self._loop.call_later(timeout + _PATIENCE_S, late)
        try:
            return await answer
        except asyncio.CancelledError:
            give_up()
            raise
        except DeadlineExceeded:
            # The server's own comes earlier.
            if self._loop.time() >= ends:
                give_up()
            raise
        finally:
            timer.cancel()

    @override
    async def open_lane(self, address: str, extensions: tuple[str, ...]) -> AsyncLane:
        return await AsyncLane.open(address, extensions)

    @override
    async def ask_lane(
        self,
        lane: AsyncLane,
        path: str,
        windows: NDArray[np.float32],
        timeout: float,
        wait: float,
        spread: bool,
        traceparent: str | None,
    ) -> Reply:
        return await lane.infer(path, windows, timeout, wait, spread=spread, traceparent=traceparent)

    @override
    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

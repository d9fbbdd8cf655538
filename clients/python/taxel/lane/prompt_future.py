"""A future that can go on with its task at once, where others wait for the loop's next turn."""

import asyncio
from asyncio import Future
from collections.abc import Callable
from contextvars import Context
from typing import Any, TypeVar

from typing_extensions import override

T = TypeVar("T")


class PromptFuture(Future[T]):
    """Awaited by one task. Without `settle`, it is as any other."""

    _waiter: tuple[Callable[[Any], object], Context | None] | None = None

    @override
    def add_done_callback(self, fn: Callable[[Any], object], /, *, context: Context | None = None) -> None:
        self._waiter = None if self._waiter else (fn, context)
        super().add_done_callback(fn, context=context)

    def settle(self, result: T) -> None:
        """Set the result, unless it is done, and go on with its task; for callbacks of its loop."""
        if self.done():
            return
        waits, context = self._waiter or (None, None)
        # Within a task, none can go on: such a loop runs inside of a task, as in some notebooks.
        if waits is None or context is None or asyncio.current_task(self.get_loop()) is not None:
            self.set_result(result)
            return
        self.remove_done_callback(waits)
        self.set_result(result)
        context.run(waits, self)

"""A progress bar beside what is timed: no thread of its own, drawn only where it is told of progress."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from rich.progress import Progress, TaskID

from taxel.commands.cli import ERR

Watch = Callable[[float], None]
"""Told between calls how much is done; never during one."""

_PERIOD_S: Final = 1.0
"""Between two drawings: what they leave in the caches is met by too few calls to reach a p99."""


class QuietBar:
    """A bar on the terminal; made by `progress_bar`."""

    def __init__(self, progress: Progress, task: TaskID) -> None:
        self._progress = progress
        self._task = task
        self._due = 0.0

    def say(self, what: str) -> None:
        """Draw what is being done now."""
        self._progress.update(self._task, description=what, refresh=True)

    def reach(self, done: float) -> None:
        """So much of the total is done; drawn if the last time was long enough ago."""
        now = time.monotonic()
        if now >= self._due:
            self._due = now + _PERIOD_S
            self._progress.update(self._task, completed=done, refresh=True)


@contextmanager
def progress_bar(what: str, total: float) -> Iterator[QuietBar]:
    """A bar on stderr until the block ends; nothing where that is no terminal."""
    with Progress(console=ERR, transient=True, auto_refresh=False, disable=not ERR.is_terminal) as progress:
        yield QuietBar(progress, progress.add_task(what, total=total))


def ignore(done: float) -> None:
    """Watches nothing."""


def shifted(watch: Watch, by: float) -> Watch:
    """Tells of a part that begins where `by` of the whole is done."""
    return lambda done: watch(by + done)

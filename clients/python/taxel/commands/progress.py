"""What a command is doing, on standard error: in place on a terminal, else a line now and then."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from taxel.commands.cli import ERR

BETWEEN_LINES_S: Final = 10.0


@contextmanager
def shown(
    doing: str, console: Console = ERR, *, every_s: float = BETWEEN_LINES_S
) -> Iterator[Callable[[str], None]]:
    """Shows what is done while the context lasts.

    Args:
        doing: what it begins with.
        every_s: seconds between two lines at least, where the console is no terminal, such as a log file.

    Yields:
        a function that is told what is done now.
    """
    if console.is_terminal:
        with console.status(doing) as status:
            yield status.update
        return
    last = float("-inf")

    def tell(now_doing: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= every_s:
            console.print(f"{now_doing} …", soft_wrap=True)
            last = now

    tell(doing)
    yield tell


class ProgressBar:
    """How far a command is; made by `bar`.

    Args:
        doing: what it begins with.
        draw: is told what is done now, the share of it that is done, and a note.
    """

    def __init__(self, doing: str, draw: Callable[[str, float, str], None]) -> None:
        self._doing, self._draw = doing, draw

    def say(self, doing: str) -> None:
        """What is done now, from its beginning."""
        self._doing = doing
        self._draw(doing, 0.0, "")

    def reach(self, share: float, note: str = "") -> None:
        """So much of it is done, 0 to 1."""
        self._draw(self._doing, share, note)


@contextmanager
def bar(doing: str, console: Console = ERR, *, every_s: float = BETWEEN_LINES_S) -> Iterator[ProgressBar]:
    """Shows how much is done while the context lasts: a bar on a terminal, else lines.

    Args:
        doing: what it begins with.
        every_s: seconds between two lines at least, where the console is no terminal.
    """
    if not console.is_terminal:
        with shown(doing, console, every_s=every_s) as tell:

            def write(now_doing: str, share: float, note: str) -> None:
                tell(f"{now_doing}: {note or f'{share:.0%}'}" if share or note else now_doing)

            yield ProgressBar(doing, write)
        return
    words = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}")
    with Progress(*words, TimeElapsedColumn(), TimeRemainingColumn(), console=console) as progress:
        task = progress.add_task(doing, total=1.0, note="")

        def draw(now_doing: str, share: float, told: str) -> None:
            if share == 0.0:
                progress.reset(task)
            progress.update(task, description=now_doing, completed=share, note=told)

        yield ProgressBar(doing, draw)

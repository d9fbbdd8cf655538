"""What a command is doing, on standard error: one changing line on a terminal, else a line now and then."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from rich.console import Console

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

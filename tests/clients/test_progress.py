"""What commands say of their progress: in place on a terminal, and in lines of a log file."""

import io

from rich.console import Console

from taxel.commands.progress import shown


def written(*, terminal: bool, every_s: float) -> str:
    file = io.StringIO()
    console = Console(file=file, force_terminal=terminal, width=80)
    with shown("reading", console, every_s=every_s) as tell:
        for place in range(3):
            tell(f"looking at form {place}")
    return file.getvalue()


def test_a_log_file_gets_lines() -> None:
    looking = [f"looking at form {n} …" for n in range(3)]
    assert written(terminal=False, every_s=0.0).splitlines() == ["reading …", *looking]


def test_a_log_file_is_not_filled() -> None:
    assert written(terminal=False, every_s=60.0) == "reading …\n"


def test_a_terminal_shows_what_is_done_now() -> None:
    assert "looking at form 2" in written(terminal=True, every_s=60.0)

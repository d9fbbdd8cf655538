"""What commands say of their progress: in place on a terminal, and in lines of a log file."""

import io

from rich.console import Console

from taxel.commands.progress import bar, shown


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


def measured(*, terminal: bool, every_s: float) -> str:
    file = io.StringIO()
    console = Console(file=file, force_terminal=terminal, width=120)
    with bar("reading", console, every_s=every_s) as progress:
        progress.reach(0.5)
        progress.say("training")
        for place in range(1, 4):
            progress.reach(place / 4, f"{place} of 4 epochs")
    return file.getvalue()


def test_a_log_file_is_told_how_far_a_command_is() -> None:
    lines = measured(terminal=False, every_s=0.0).splitlines()
    assert lines[:3] == ["reading …", "reading: 50% …", "training …"]
    assert lines[3:] == [f"training: {place} of 4 epochs …" for place in range(1, 4)]


def test_a_bar_says_on_a_terminal_what_is_done_now() -> None:
    assert "3 of 4 epochs" in measured(terminal=True, every_s=60.0)

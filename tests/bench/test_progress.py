"""Progress of long measurements: drawn on a terminal, between calls; never among the results."""

import io
import json
import os
import pty
import subprocess
import sys
import threading
from itertools import pairwise
from pathlib import Path

import pytest
from rich.console import Console

from taxel_bench import progress
from taxel_bench.progress import progress_bar
from taxel_bench.run.protocols import Effort, run_paper, run_serving
from taxel_bench.subjects.subject import open_subject

QUICK = ("--repetitions", "20", "--seconds", "0.1", "--json")
COMMANDS = {
    "run": ("run", "--model", "network-b", "--batch", "1,8", *QUICK),
    "table": ("table", "-o", "table", "--models", "network-b", "--inputs", "3", "--batch", "1", *QUICK),
}


def test_every_part_of_the_work_is_told() -> None:
    serving: list[float] = []
    paper: list[float] = []
    with open_subject("network-b") as subject:
        run_serving(subject, [1, 8], Effort(repetitions=20, seconds=0.1), serving.append)
        run_paper(subject, Effort(), paper.append)
    for told, total in ((serving, 2), (paper, 1)):
        assert all(earlier <= later for earlier, later in pairwise(told))
        assert max(later - earlier for earlier, later in pairwise([0, *told])) < 0.1
        assert told[-1] == pytest.approx(total)


def test_a_bar_is_drawn_in_its_own_time_and_by_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    clock = 100.0
    monkeypatch.setattr(progress, "ERR", Console(file=screen, force_terminal=True, width=80))
    monkeypatch.setattr("taxel_bench.progress.time.monotonic", lambda: clock)
    threads = threading.active_count()
    with progress_bar("loading", 4) as bar:
        assert threading.active_count() == threads
        bar.say("measuring")
        bar.reach(1)
        bar.reach(2)
        drawn = screen.getvalue()
        clock += 1
        bar.reach(3)
    assert "loading" in drawn
    assert "measuring" in drawn
    assert "25%" in drawn
    assert "50%" not in screen.getvalue()
    assert "75%" in screen.getvalue().removeprefix(drawn)


@pytest.mark.parametrize("command", ["run", pytest.param("table", marks=pytest.mark.long)])
def test_a_terminal_shows_a_bar_and_json_stays_clean(command: str, tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "taxel_bench", *COMMANDS[command]],
        stdout=subprocess.PIPE,
        stderr=theirs,
        cwd=tmp_path,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
        text=True,
    )
    os.close(theirs)
    screen = _read_to_the_end(ours)
    output, _ = process.communicate()
    assert process.returncode == 0, screen
    assert len(json.loads(output)["results"]) == (4 if command == "run" else 2)
    assert "loading" in screen
    assert ("measuring" if command == "run" else "network-b, inputs 3") in screen
    assert "━" in screen


def _read_to_the_end(terminal: int) -> str:
    parts = []
    try:
        while part := os.read(terminal, 4096):
            parts.append(part)
    except OSError:
        # This is how Linux tells that nobody holds the other end any more.
        pass
    os.close(terminal)
    return b"".join(parts).decode()

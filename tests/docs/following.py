"""A page is followed: its commands and examples run one after the other; what they print is compared."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Final

import pytest

from taxel_bench.server_process import free_port

from .blocks import ALL, ROOT, Block, blocks, joined_lines
from .given import (
    CHECKS,
    ELSEWHERE,
    ENDPOINT,
    GIVEN,
    MEASURED,
    MISSING,
    PRELUDES,
    SLOW,
    SMALLER,
    STAND_INS,
    STARTED,
    TELLING,
    TOGETHER,
)

SERVE: Final = f"taxel serve --listen {ENDPOINT}"
"""A server of the shipped models, as README starts it. All pages have the same one."""

PORTS: Final = re.compile(r"(?<=[:/ ])(7447|7448|7449|7450|7461|8786)\b")
"""What the pages call ports. The tests take free ones."""

FOLLOWED: Final = sorted({one.page for one in ALL if one.language in ("sh", "ts")} - {*MEASURED})
"""Pages with something to follow, on any machine."""


def in_turn(pages: Iterable[str]) -> list[Any]:
    """A test for each page, in order; the slow ones are of `make long`."""
    return [pytest.param(page, marks=[pytest.mark.long] if page in SLOW else []) for page in sorted(pages)]


def _pages_with(command: str) -> list[str]:
    lines = {(one.page, line) for one in ALL if one.language == "sh" for line in joined_lines(one.text)}
    return sorted({page for page, line in lines if re.search(rf"\b{command} ", line)} & {*FOLLOWED})


INSTALLING: Final = _pages_with("pip install")
"""Those that install Taxel: test_install_pages.py follows them."""

MEASURING: Final = sorted({*_pages_with("bench")} - {*INSTALLING})
"""Those that measure: test_bench_pages.py follows them."""

_PATIENCE_S: Final = 240.0


def stood_in(text: str) -> str:
    """A page's text with what a test has instead of a reader's own things."""
    for shown, there in STAND_INS.items():
        text = text.replace(shown, there)
    return text


def in_small(line: str) -> str:
    """A page's line with its stand-ins, and what makes it small."""
    known = [begin for begin in SMALLER if line.startswith(begin)]
    if not known:
        return stood_in(line)
    command, _, _ = stood_in(line).partition("  #")
    return f"{command} {SMALLER[max(known, key=len)]}"


def is_named(line: str) -> bool:
    """Whether a line is not run here, with a reason."""
    return line.startswith((*MISSING, *ELSEWHERE))


class Follower:
    """Runs the blocks of a page in a folder.

    Args:
        folder: where they run.
        server: the port of a server of the shipped models; None where a page starts its own.
        variables: of its shell, beside those of the tests.
    """

    def __init__(
        self, folder: Path, server: int | None = None, variables: Mapping[str, str] | None = None
    ) -> None:
        self._folder, self._server = folder, server
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        self._environment = {
            **os.environ,
            "PATH": path,
            "COLUMNS": "120",
            "TAXEL_PYTHON": sys.executable,
            **(variables or {}),
        }
        self._ports: dict[str, int] = {} if server is None else {"7447": server}
        self._running = ExitStack()
        self._again: Callable[[], str] | None = None
        self.printed = ""

    def __enter__(self) -> "Follower":
        return self

    def __exit__(self, *_: object) -> None:
        self._running.close()

    def port(self, shown: str) -> int:
        """The port that stands in for one of a page."""
        return self._ports.setdefault(shown, free_port())

    def follow(self, page: str) -> None:
        """All blocks of a page, after what is given."""
        for block in [Block(page, 0, "sh", GIVEN.get(page, "")), *blocks(page)]:
            where = str(block)
            if block.language == "sh":
                self.shell(block.text, where, page)
            elif block.language == "python" and page in TOGETHER:
                self.python(f"{PRELUDES.get(page, '')}\n{block.text}\n{CHECKS.get(page, '')}", where)
            elif block.language == "ts":
                self.typescript(block, where)
            elif block.language == "output" and (page in TOGETHER or page.startswith("clients/typescript")):
                self.compare(block.text, where)

    def shell(self, text: str, where: str, page: str) -> None:
        """The lines of a block: one shell for those between two that are started and go on."""
        shown = [line for line in joined_lines(text) if not is_named(line)]
        self.lines([line for line in shown if not _runs_elsewhere(line, page)], where)

    def lines(self, shown: list[str], where: str) -> None:
        """The same, for lines of which none is left out."""
        waiting: list[str] = []
        for line in map(in_small, shown):
            if line.startswith(tuple(STARTED)):
                self._foreground(waiting, where)
                self._start(line, where)
            else:
                waiting.append(line)
        self._foreground(waiting, where)

    def python(self, program: str, where: str) -> None:
        """A Python program."""
        self._again = partial(self._run, ["python", "-c", self._placed(stood_in(program))], where)
        self.printed = self._again()

    def typescript(self, block: Block, where: str) -> None:
        """A program of the TypeScript client, compiled as strictly as its own."""
        name = f"block_{block.line}"
        (self._folder / "test" / f"{name}.ts").write_text(self._placed(block.text))
        self._run(["npm", "run", "--silent", "build"], where)
        self.printed = self._run(
            ["node", "--no-warnings", "--experimental-websocket", f"build/test/{name}.js"], where
        )

    def compare(self, shown: str, where: str) -> None:
        """What was printed last, with what a page shows."""
        ends = time.monotonic() + _PATIENCE_S
        while self._again and not matches(self.printed, shown) and time.monotonic() < ends:
            self.printed = self._again()  # A server that runs sees new files within seconds.
        compare(self.printed, shown, where)

    def _placed(self, text: str) -> str:
        return PORTS.sub(lambda found: str(self.port(found[0])), text)

    def _foreground(self, lines: list[str], where: str) -> None:
        if lines:
            text = self._placed("\n".join(lines))
            self._again, self.printed = (
                None,
                self._run(["bash", "-ec", text], where, telling=text.startswith(TELLING)),
            )
        lines.clear()

    def _run(self, command: list[str], where: str, *, telling: bool = False) -> str:
        done = subprocess.run(
            command,
            cwd=self._folder,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_PATIENCE_S,
            check=False,
        )
        assert done.returncode in ((0, 1) if telling else (0,)), f"{where}: {done.stderr}\n{done.stdout}"
        assert "Traceback" not in done.stderr, f"{where}: {done.stderr}"
        # pip installs the rest and ends well.
        assert "does not provide the extra" not in done.stderr, f"{where}: {done.stderr}"
        return done.stdout

    def _start(self, line: str, where: str) -> None:
        """Start a program and wait until it says that it is there; it ends with the page."""
        if line == SERVE and self._server is not None:
            self._ports["7447"] = self._server
            return
        if line.startswith(("taxel serve", "python -c")):
            self._ports["7447"] = free_port()
        log = self._folder / f"log{len(list(self._folder.glob('log*')))}"
        with log.open("w") as file:
            process = subprocess.Popen(
                ["bash", "-c", f"exec {self._placed(line)}"],
                cwd=self._folder,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
            )
        self._running.callback(_end, process, log, where)
        said = next(said for begin, said in STARTED.items() if line.startswith(begin))
        ends = time.monotonic() + _PATIENCE_S
        while said not in log.read_text():
            assert process.poll() is None, f"{where}: {line} has ended: {log.read_text()}"
            assert time.monotonic() < ends, f"{where}: {line} does not say {said!r}: {log.read_text()}"
            time.sleep(0.05)


def _end(process: subprocess.Popen[bytes], log: Path, where: str) -> None:
    process.terminate()
    try:
        process.wait(60)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    assert "Traceback" not in log.read_text(), f"{where}: {log.read_text()}"


def _runs_elsewhere(line: str, page: str) -> bool:
    """Whether the loop, which takes longest, runs in the same words where the first page is followed."""
    first = "docs/start.md"
    return (
        line.startswith("taxel loop --")
        and page != first
        and line in (ROOT / first).read_text().splitlines()
    )


def compare(printed: str, shown: str, where: str) -> None:
    """Fail if a page shows something else."""
    assert matches(printed, shown), f"{where}: the page shows\n{shown}\nbut it prints\n{printed}"


def matches(printed: str, shown: str) -> bool:
    """`…` in what a page shows stands for anything."""
    pattern = ".*".join(map(re.escape, shown.rstrip("\n").split("…")))
    return re.fullmatch(pattern, printed.rstrip("\n"), re.DOTALL) is not None

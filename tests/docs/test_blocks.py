"""The fenced blocks of README and docs: each names its language, commands are understood, examples run.

What takes long, needs a package index or changes the machine is not run. Its commands are parsed.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Final, NamedTuple
from xml.etree import ElementTree

import pytest
import typer

from taxel.commands.cli import build
from taxel_bench.commands import app as bench_app
from taxel_bench.server_process import running_server
from taxel_models.shipped import shipped_repository

ROOT: Final = Path(__file__).resolve().parents[2]
PAGES: Final = sorted(
    str(page.relative_to(ROOT))
    for page in [
        *ROOT.glob("*.md"),
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / "docs" / "results").rglob("*.md"),
        *(
            ROOT / room / "README.md"
            for room in ("bench", "clients", "clients/typescript", "server", "models", "tests")
        ),
    ]
)
LANGUAGES: Final = {"sh", "ts", "python", "output", "text", "json", "json5", "toml", "xml"}

ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""What the pages call a server. The tests run one on a free port."""


class Block(NamedTuple):
    """A fenced block: where it begins, its language, and its lines."""

    page: str
    line: int
    language: str
    text: str


def blocks(page: str) -> list[Block]:
    found, opened, lines = [], None, list[str]()
    for number, line in enumerate((ROOT / page).read_text().splitlines(), 1):
        if not line.startswith("```"):
            lines.append(line)
        elif opened is None:
            opened, lines = (number, line[3:].strip()), []
        else:
            found.append(Block(page, *opened, "\n".join(lines) + "\n"))
            opened = None
    assert opened is None, f"{page}:{opened}: this block is not closed"
    return found


ALL: Final = [block for page in PAGES for block in blocks(page)]


def test_every_block_names_its_language() -> None:
    unnamed = [f"{block.page}:{block.line}" for block in ALL if block.language not in LANGUAGES]
    assert not unnamed
    assert len(ALL) > 40


READERS: Final[dict[str, Callable[[str], object]]] = {
    "json": json.loads,
    "toml": tomllib.loads,
    "xml": ElementTree.fromstring,
}


@pytest.mark.parametrize("block", [one for one in ALL if one.language in READERS], ids=str)
def test_data_can_be_read(block: Block) -> None:
    READERS[block.language](block.text)


def commands(block: Block) -> list[list[str]]:
    """The `taxel` and `bench` commands of a block, as their words."""
    found = []
    for line in block.text.replace("\\\n", " ").splitlines():
        for part in re.split(r"&&|\|", line):
            if re.match(r"\s*(taxel|bench)\s", part):
                found.append(shlex.split(part.partition(" > ")[0], comments=True))
    return found


COMMANDS: Final = [
    (f"{block.page}:{block.line}", words)
    for block in ALL
    if block.language == "sh"
    for words in commands(block)
]


@pytest.mark.parametrize(("where", "words"), COMMANDS, ids=[" ".join(words) for _, words in COMMANDS])
def test_commands_are_understood(where: str, words: list[str]) -> None:
    """Every command and option exists, and no argument is too many."""
    command = typer.main.get_command(build() if words[0] == "taxel" else bench_app)
    context, left = command.make_context(words[0], [], resilient_parsing=True), words[1:]
    while (subcommands := getattr(command, "commands", None)) is not None:
        assert left, f"{where}: expected a command"
        assert left[0] in subcommands, f"{where}: no command {left[0]!r}"
        command = subcommands[left[0]]
        context, left = command.make_context(left[0], [], context, resilient_parsing=True), left[1:]
    _, unknown, _ = command.make_parser(context).parse_args(list(left))
    assert not unknown, f"{where}: {unknown}"


PRELUDES: Final = {
    # What a page's Python examples take as given.
    "clients/README.md": """
import asyncio, taxel
import numpy as np
from taxel.windows import build_windows
source = taxel.connect("tcp/127.0.0.1:7447")
predictor = source.predictor("xgb")
windows = a = b = np.zeros((3, predictor.window.length), np.float32)
""",
    "docs/replicas.md": "import taxel\n",
    "docs/recordings.md": """
from taxel_models.recordings import write_ruppel
from taxel_models.twin import simulate
from pathlib import Path
write_ruppel(simulate(300, 1), Path("night_run.csv"))
""",
}

NOT_RUN: Final = {
    # Run elsewhere, or they need a file or a machine that this test does not have.
    "README.md": "tests/end_to_end/test_readme.py",
    "docs/simulators.md": "tests/end_to_end/test_readme.py",
    "docs/gazebo.md": "tests/exporters/gazebo",
    "docs/other_simulators.md": "tests/clients/test_gymnasium.py has an environment",
    "docs/security.md": "tests/server/test_access.py has certificates and users",
    "docs/loop.md": "the blocks before it take minutes; tests/exporters/test_corrected.py",
}


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    with running_server(shipped_repository()) as endpoint:
        yield endpoint


def _environment() -> dict[str, str]:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "COLUMNS": "120"}


def _run(command: list[str], folder: Path, where: str) -> str:
    done = subprocess.run(
        command, cwd=folder, env=_environment(), capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, f"{where}: {done.stderr}\n{done.stdout}"
    return done.stdout


PYTHON_PAGES: Final = sorted({one.page for one in ALL if one.language == "python"} - set(NOT_RUN))


def _awaited(text: str) -> str:
    lines = "".join(f"    {line}\n" for line in text.splitlines())
    return f"async def example():\n{lines}asyncio.run(example())\n"


@pytest.mark.parametrize("page", [page for page in PYTHON_PAGES if page != "docs/start.md"])
def test_python_examples_run(page: str, server: str, tmp_path: Path) -> None:
    """All examples of a page, one after the other, in one program, and what they print."""
    parts = [PRELUDES.get(page, "")]
    for block in blocks(page):
        if block.language == "python":
            parts.append(_awaited(block.text) if "async with" in block.text else block.text)
    text = "\n".join(parts)
    for given, there in STAND_INS.items():
        text = text.replace(given, there)
    text = text.replace(ENDPOINT, server)
    script = tmp_path / "example.py"
    script.write_text(text)
    printed = _run([sys.executable, str(script)], tmp_path, page)
    expected = [block.text for block in blocks(page) if block.language == "output"]
    if expected:
        _compare(printed, "".join(expected), page)


STAND_INS: Final = {
    '["tcp/10.0.0.1:7447", "tcp/10.0.0.2:7447", "tcp/10.0.0.3:7447"]': f'["{ENDPOINT}"]',
    'MemoryServer("repository")': "MemoryServer()",
    '"mine"': '"xgb"',
}
"""What a page calls a reader's own repository and model, and what a test has instead."""

SMALLER: Final = {"-o trained\n": "-o trained --set n_estimators=20\n"}
"""What makes a page's commands quick enough for a test."""

NEVER: Final = ("pip ", "make ", "bench ", "taxel check")
"""What `taxel check` says depends on how busy the machine is."""


@pytest.mark.parametrize("page", ["docs/start.md", "docs/your_recordings.md"])
def test_a_page_can_be_followed(page: str, tmp_path: Path) -> None:
    """The commands and examples of a page work one after the other, and print what the page shows."""
    if page != "docs/start.md":
        for name, seed in (("mine", "7"), ("measured", "8")):
            _run(["taxel", "twin", "--rows", "3000", "--seed", seed, "-o", f"{name}.csv"], tmp_path, page)
    with ExitStack() as servers:
        endpoint, printed = ENDPOINT, ""
        for block in blocks(page):
            where = f"{block.page}:{block.line}"
            if block.language == "output":
                _compare(printed, block.text, where)
            for command in _steps(block):
                if command[-1].startswith("taxel serve"):
                    endpoint = servers.enter_context(running_server(_repository(command[-1], tmp_path)))
                else:
                    printed = _run([one.replace(ENDPOINT, endpoint) for one in command], tmp_path, where)


def _steps(block: Block) -> list[list[str]]:
    """What a block runs: one Python program, or a shell for each line."""
    text = block.text
    for long, short in SMALLER.items():
        text = text.replace(long, short)
    if block.language == "python":
        return [[sys.executable, "-c", text]]
    lines = text.splitlines() if block.language == "sh" else []
    return [["bash", "-ec", line] for line in lines if not line.startswith(NEVER)]


def _repository(serve: str, folder: Path) -> Path:
    named = re.search(r"--repository (\S+)", serve)
    return folder / named[1] if named else shipped_repository()


def _compare(printed: str, shown: str, where: str) -> None:
    """`…` in what a page shows stands for anything."""
    pattern = ".*".join(map(re.escape, shown.rstrip("\n").split("…")))
    matches = re.fullmatch(pattern, printed.rstrip("\n"), re.DOTALL)
    assert matches, f"{where}: the page shows\n{shown}\nbut it prints\n{printed}"

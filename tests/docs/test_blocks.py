"""The fenced blocks of README and docs: each names its language, commands are understood, examples run.

What takes long, needs a package index or changes the machine is not run. Its commands are parsed. So are
those that made the pictures and results of `docs/figures.json`.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple
from xml.etree import ElementTree

import pytest
import typer

from taxel.commands.cli import build
from taxel_bench.commands import app as bench_app
from taxel_bench.server_process import free_port, running_server, start_server
from taxel_models.loop.effects.registry import NAMES
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
        found += commands_of(line)
    return found


def commands_of(line: str) -> list[list[str]]:
    parts = [part for part in re.split(r"&&|\|", line) if re.match(r"\s*(taxel|bench)\s", part)]
    return [shlex.split(part.partition(" > ")[0], comments=True) for part in parts]


FIGURES: Final = json.loads((ROOT / "docs" / "figures.json").read_text())

COMMANDS: Final = [
    (f"{block.page}:{block.line}", words)
    for block in ALL
    if block.language == "sh"
    for words in commands(block)
] + [(figure["files"][0], words) for figure in FIGURES for words in commands_of(figure["command"])]


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
    "docs/gazebo.md": """
import numpy as np, taxel
windows, tdc = np.ones((3, 12), np.float32), np.full(3, 1970, np.float32)
""",
    "docs/other_simulators.md": f"""
import runpy, gymnasium, mujoco, taxel, taxel.gymnasium, taxel.mujoco
import numpy as np

class Finger(gymnasium.Env):
    observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    dt = 0.01
    model = mujoco.MjModel.from_xml_string(
        runpy.run_path({str(ROOT / "examples" / "mujoco_fingertip.py")!r})["SCENE"]
    )
    data = mujoco.MjData(model)
    def reset(self, *, seed=None, options=None):
        mujoco.mj_forward(self.model, self.data)
        return np.zeros(1, np.float32), {{}}

env, predictor = Finger(), taxel.load().predictor()
""",
    "docs/replicas.md": "import taxel\n",
    "docs/security.md": "import numpy as np, taxel\nwindows = np.zeros((1, 12), np.float32)\n",
    "docs/recordings.md": """
from taxel_models.recordings import write_ruppel
from taxel_models.twin import simulate
from pathlib import Path
write_ruppel(simulate(300, 1), Path("night_run.csv"))
""",
}

CHECKS: Final = {
    # What a page says in words of what its examples give.
    "README.md": "assert list(dict(zip(taxel.CHANNELS, channels[0].tolist()))) == list(taxel.CHANNELS)",
    "docs/gazebo.md": "assert counts.shape == (3, 21) and abs(warm - counts).max() > 0.01",
    "docs/loop.md": "assert predictor.manifest.version == '2' and channels.shape == (1, 21)",
    "docs/other_simulators.md": "assert observation['channels'].shape == (1, 21)",
    "docs/security.md": "assert server.predictor('xgb').predict(windows).shape == (1, 21)",
    "docs/simulators.md": "assert channels.shape == (64, 21)",
}

_SHIPPED: Final = "$(python -c 'from taxel.local import shipped_repository; print(shipped_repository())')"
_GAZEBO: Final = str(ROOT / "tests" / "exporters" / "gazebo" / "conftest.py")

FOLLOWED: Final = {
    # Pages whose blocks work one after the other, and what they take as given.
    "docs/start.md": "",
    "docs/your_recordings.md": """
taxel twin --rows 3000 --seed 7 -o mine.csv
taxel twin --rows 3000 --seed 8 -o measured.csv
""",
    "docs/loop.md": "",
    "docs/twin.md": "",
    "docs/gazebo.md": f"""
python -c "import pathlib, runpy; runpy.run_path('{_GAZEBO}')['network_b']().write(pathlib.Path('.'))"
""",
    "docs/security.md": f"""
mkdir repository && cp -r {_SHIPPED}/xgb repository/
python -m trustme -q -i localhost && mv client.pem ca.pem
printf 'robot:…\noperator:turns\n' > users
""",
}

STAND_INS: Final = {
    '["tcp/10.0.0.1:7447", "tcp/10.0.0.2:7447", "tcp/10.0.0.3:7447"]': f'["{ENDPOINT}"]',
    'MemoryServer("repository")': "MemoryServer()",
    '"mine"': '"xgb"',
}
"""What a page calls a reader's own repository and model, and what a test has instead."""

_FEW: Final = "".join(f" --exclude {name}" for name in NAMES if name not in ("creep", "offset"))

SMALLER: Final = {
    "-o trained\n": "-o trained --set n_estimators=20\n",
    "--least-share 0.015": f"--stability 0{_FEW}",
    "--data measured.csv -o report --export": f"--data measured.csv -o report --export --stability 0{_FEW}",
    "--rows 60000 --effect creep:1": "--rows 12000 --effect creep:1",
}
"""What makes a page's commands quick enough for a test."""

NEVER: Final = (
    "pip ",
    "make ",
    "bench ",
    "taxel check",
    "taxel watch",
    "taxel loop --model xgb --repository REPO",
)
"""What `taxel check` says depends on how busy the machine is. `taxel watch` runs until somebody ends it."""


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


PYTHON_PAGES: Final = sorted({one.page for one in ALL if one.language == "python"} - set(FOLLOWED))


def _awaited(text: str) -> str:
    lines = "".join(f"    {line}\n" for line in text.splitlines())
    return f"async def example():\n{lines}asyncio.run(example())\n"


def test_the_readme_example_is_short() -> None:
    (example,) = (block for block in blocks("README.md") if block.language == "python")
    assert len(example.text.strip().splitlines()) <= 12


@pytest.mark.parametrize("page", PYTHON_PAGES)
def test_python_examples_run(page: str, server: str, tmp_path: Path) -> None:
    """All examples of a page, one after the other, in one program, and what they print."""
    parts = [PRELUDES.get(page, "")]
    for block in blocks(page):
        if block.language == "python":
            parts.append(_awaited(block.text) if "async with" in block.text else block.text)
    text = "\n".join([*parts, CHECKS.get(page, "")])
    for given, there in STAND_INS.items():
        text = text.replace(given, there)
    text = text.replace(ENDPOINT, server)
    script = tmp_path / "example.py"
    script.write_text(text)
    printed = _run([sys.executable, str(script)], tmp_path, page)
    expected = [block.text for block in blocks(page) if block.language == "output"]
    if expected:
        _compare(printed, "".join(expected), page)


@pytest.mark.parametrize("page", FOLLOWED)
def test_a_page_can_be_followed(page: str, server: str, tmp_path: Path) -> None:
    """The commands and examples of a page work one after the other, and print what the page shows."""
    endpoint, printed = server, ""
    again: Callable[[], str] | None = None
    with ExitStack() as servers:
        for block in [Block(page, 0, "sh", FOLLOWED[page]), *blocks(page)]:
            where = f"{block.page}:{block.line}"
            if block.language == "output":
                ends = time.monotonic() + 30.0
                while again is not None and not _matches(printed, block.text) and time.monotonic() < ends:
                    printed = again()  # A server that runs sees new files within seconds.
                _compare(printed, block.text, where)
            for command in _steps(block):
                if command[-1].startswith("taxel serve"):
                    endpoint = _serve(command[-1], tmp_path, servers) or server
                else:
                    there = [
                        re.sub(r"tcp/127.0.0.1:7447|tls/robot.example:7447", endpoint, one)
                        for one in command
                    ]
                    printed = _run(there, tmp_path, where)
                    again = partial(_run, there, tmp_path, where) if block.language == "python" else None


def _steps(block: Block) -> list[list[str]]:
    """What a block runs: one Python program, one shell, or a shell a line where one starts a server."""
    if block.language == "python":
        program = f"{PRELUDES.get(block.page, '')}\n{block.text}\n{CHECKS.get(block.page, '')}"
        return [[sys.executable, "-c", program]]
    if block.language != "sh":
        return []
    lines = block.text.replace("\\\n", " ").splitlines()
    text = "".join(f"{line}\n" for line in lines if not line.startswith(NEVER) and not _again(block, line))
    for long, short in SMALLER.items():
        text = text.replace(long, short)
    return [["bash", "-ec", one] for one in (text.splitlines() if "taxel serve" in text else [text])]


def _again(block: Block, line: str) -> bool:
    """Whether the loop, which takes longest, runs in the same words where the first page is followed."""
    first = "docs/start.md"
    return line.startswith("taxel loop") and block.page != first and line in (ROOT / first).read_text()


def _serve(line: str, folder: Path, servers: ExitStack) -> str | None:
    """Start what a page starts, on a free port. None for a server of the shipped models, which is there."""
    words = shlex.split(line)[2:]
    options = list(zip(words[::2], words[1::2], strict=True))
    repository = folder / dict(options).get("--repository", "repository")
    if not repository.exists():
        return None
    others = [one for one in options if one[0] not in ("--repository", "--listen")]
    arguments = [
        str(folder / word) if (folder / word).is_file() else word for pair in others for word in pair
    ]
    endpoint = f"{'tls/localhost' if '--tls-key' in arguments else 'tcp/127.0.0.1'}:{free_port()}"
    process = start_server(repository, endpoint, *arguments)
    servers.callback(process.communicate)
    servers.callback(process.terminate)
    return endpoint


def _compare(printed: str, shown: str, where: str) -> None:
    assert _matches(printed, shown), f"{where}: the page shows\n{shown}\nbut it prints\n{printed}"


def _matches(printed: str, shown: str) -> bool:
    """`…` in what a page shows stands for anything."""
    pattern = ".*".join(map(re.escape, shown.rstrip("\n").split("…")))
    return re.fullmatch(pattern, printed.rstrip("\n"), re.DOTALL) is not None

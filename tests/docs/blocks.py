"""The fenced blocks of README and docs, and the commands in them."""

import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[2]

ROOMS: Final = (
    "bench",
    "clients",
    "docs",
    "examples",
    "exporters",
    "models",
    "packaging",
    "server",
    "tests",
)


def _pages() -> Iterator[str]:
    for page in [*ROOT.glob("*.md"), *(each for room in ROOMS for each in (ROOT / room).rglob("*.md"))]:
        name = page.relative_to(ROOT).as_posix()
        if "node_modules" not in name:
            yield name


PAGES: Final = sorted(_pages())


class Block(NamedTuple):
    """A fenced block: where it begins, its language, and its lines."""

    page: str
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks(page: str) -> list[Block]:
    """Those of a page, in its order."""
    found, opened, lines = [], None, list[str]()
    for number, line in enumerate((ROOT / page).read_text().splitlines(), 1):
        if not line.startswith("```"):
            assert not line.lstrip().startswith("```"), (
                f"{page}:{number}: expected a block that is not indented"
            )
            lines.append(line)
        elif opened is None:
            opened, lines = (number, line[3:].strip()), []
        else:
            found.append(Block(page, *opened, "\n".join(lines) + "\n"))
            opened = None
    assert opened is None, f"{page}:{opened}: this block is not closed"
    return found


ALL: Final = [block for page in PAGES for block in blocks(page)]


def joined_lines(text: str) -> list[str]:
    """Lines of a shell, those that go on after a backslash as one."""
    return text.replace("\\\n", " ").splitlines()


def commands_of(line: str) -> list[list[str]]:
    """The `taxel` and `bench` commands of a line, as their words."""
    parts = [part for part in re.split(r"&&|\|", line) if re.match(r"\s*(taxel|bench)\s", part)]
    return [shlex.split(part.partition(" > ")[0], comments=True) for part in parts]


def _commands() -> Iterator[tuple[str, list[str]]]:
    for block in ALL:
        if block.language == "sh":
            for line in joined_lines(block.text):
                yield from ((str(block), words) for words in commands_of(line))
    for page in PAGES:
        # Lists of commands beside what they do are indented; they are not fenced.
        for number, line in enumerate((ROOT / page).read_text().splitlines(), 1):
            if line.startswith("    "):
                yield from (
                    (f"{page}:{number}", words)
                    for words in commands_of(re.sub("  +", "  # ", line.strip()))
                )
    for figure in json.loads((ROOT / "docs" / "figures.json").read_text()):
        yield from ((figure["files"][0], words) for words in commands_of(figure["command"]))


COMMANDS: Final = list(_commands())
"""All `taxel` and `bench` commands of the pages and of `docs/figures.json`, and where they stand."""

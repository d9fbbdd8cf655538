"""The fenced blocks of README and docs: each has a language, and runs, is read or is named."""

import json
import re
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import pytest
import typer

from taxel.commands.cli import build
from taxel.errors import TaxelError
from taxel_bench.commands import app as bench_app
from taxel_models.recordings import read_recording, write_ruppel
from taxel_models.twin import simulate

from .blocks import ALL, COMMANDS, PAGES, ROOT, Block, blocks, joined_lines
from .given import ELSEWHERE, GIVEN, MEASURED, MISSING, SMALLER, STAND_INS, STARTED, TEXTS, TOGETHER

RUN: Final = {"sh", "ts", "python"}
"""Languages that tests/docs/test_pages.py and its neighbours run."""

READERS: Final[dict[str, Callable[[str], object]]] = {
    "json": json.loads,
    "toml": tomllib.loads,
    "xml": ElementTree.fromstring,
}


def test_every_block_names_its_language() -> None:
    languages = {*RUN, *READERS, "output", "text", "json5"}
    unnamed = [str(block) for block in ALL if block.language not in languages]
    assert not unnamed
    assert len(ALL) > 40


@pytest.mark.parametrize("block", [one for one in ALL if one.language in READERS], ids=str)
def test_data_can_be_read(block: Block) -> None:
    READERS[block.language](block.text)


def test_every_text_is_looked_at_by_somebody() -> None:
    """What is neither run nor read is named, with who compares it."""
    unnamed = [str(block) for block in ALL if block.language in ("text", "json5") and not _texts_of(block)]
    assert not unnamed


def _texts_of(block: Block) -> list[str]:
    begins = f"{block.page}:{block.text.lstrip(' ')}"
    return [text for text in TEXTS if begins.startswith(text.replace(": ", ":"))]


def test_what_is_shown_is_compared() -> None:
    """An output stands on a page whose program before it is run."""
    for page in {block.page for block in ALL if block.language == "output"}:
        languages = [block.language for block in blocks(page)]
        assert page not in MEASURED, page
        assert set(languages[: languages.index("output")]) & RUN, page


def test_the_tables_name_nothing_that_is_not_there() -> None:
    """An entry that no page needs any more would hide a block that is new."""
    lines = [line for block in ALL if block.language == "sh" for line in joined_lines(block.text)]
    given = [line for text in GIVEN.values() for line in text.splitlines()]
    texts = "".join(block.text for block in ALL)
    for table in (MISSING, ELSEWHERE):
        assert [begin for begin in table if not any(line.startswith(begin) for line in lines)] == []
    assert [begin for begin in SMALLER if not any(line.startswith(begin) for line in lines)] == []
    started = [begin for begin in STARTED if not begin.startswith(sys.prefix)]
    assert [begin for begin in started if not any(line.startswith(begin) for line in lines + given)] == []
    assert [shown for shown in STAND_INS if shown not in texts] == []
    assert [text for text in TEXTS if not any(text in _texts_of(block) for block in ALL)] == []
    assert {*GIVEN, *TOGETHER, *MEASURED} <= set(PAGES)


def test_every_target_of_make_is_there() -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {
        target
        for block in ALL
        if block.language == "sh"
        for target in re.findall(r"^make ([\w-]+)", block.text, re.MULTILINE)
    }
    assert {"test", "demo"} <= named <= targets


def test_every_extra_that_is_named_is_there() -> None:
    """In the texts, too: pip installs the rest of what it is asked for, and only warns."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = {
        (page, extra)
        for page in PAGES
        for several in re.findall(r"taxel\[([a-z,0-9]+)\]", (ROOT / page).read_text())
        for extra in several.split(",")
    }
    assert len(named) > 20
    assert [each for each in sorted(named) if each[1] not in extras] == []


def test_a_launch_file_has_the_arguments_that_are_named() -> None:
    """`ros2 launch` itself is not here; tests/clients/ros2/test_rclpy.py runs the file's command."""
    texts = [(ROOT / page).read_text() for page in PAGES]
    launched = [line.split() for text in texts for line in re.findall(r"`ros2 launch ([^`]+)`", text)]
    assert launched
    for file, *given in launched:
        arguments = {each.attrib["name"] for each in ElementTree.parse(ROOT / file).iter("arg")}
        assert {one.partition(":=")[0] for one in given} <= arguments


def _understood(where: str, words: list[str]) -> None:
    command = typer.main.get_command(build() if words[0] == "taxel" else bench_app)
    context, left = command.make_context(words[0], [], resilient_parsing=True), words[1:]
    while (subcommands := getattr(command, "commands", None)) is not None:
        assert left, f"{where}: expected a command"
        assert left[0] in subcommands, f"{where}: no command {left[0]!r}"
        command = subcommands[left[0]]
        context, left = command.make_context(left[0], [], context, resilient_parsing=True), left[1:]
    _, unknown, _ = command.make_parser(context).parse_args(list(left))
    assert not unknown, f"{where}: {unknown}"


@pytest.mark.parametrize(("where", "words"), COMMANDS, ids=[" ".join(words) for _, words in COMMANDS])
def test_commands_are_understood(where: str, words: list[str]) -> None:
    """Every command and option exists, and no argument is too many."""
    _understood(where, words)


def test_a_synopsis_names_real_options() -> None:
    (synopsis,) = (
        block
        for block in blocks("docs/recordings.md")
        if block.language == "text" and block.text.startswith("taxel ")
    )
    _understood(str(synopsis), re.sub(r"[\[\]]", "", synopsis.text).split())


def test_the_readme_example_is_short() -> None:
    (example,) = (block for block in blocks("README.md") if block.language == "python")
    assert len(example.text.strip().splitlines()) <= 12


def test_damaged_recordings_are_refused_in_these_words(tmp_path: Path) -> None:
    """The first three lines of that block; tests of each format have the others."""
    (shown,) = (
        block.text for block in blocks("docs/recordings.md") if block.text.startswith("run.csv:812")
    )
    whole = tmp_path / "run.csv"
    write_ruppel(simulate(820, 1), whole)
    rows = [line.split(",") for line in whole.read_text().splitlines()]
    column = rows[0].index("field.tactiles0.pdc")
    for line, refused in zip((812, 813, 90), shown.splitlines(), strict=False):
        damaged = [list(row) for row in rows]
        if line == 812:
            damaged[line - 1][column] = "abc"
        elif line == 813:
            damaged[line - 1].pop()
        else:
            for number, row in enumerate(damaged[1:], 2):
                row[0] = str(1518709123456789012 + (number - 89) * 10_000_000)
            damaged[line - 1][0] = "1518709123456789000"
        whole.write_text("".join(f"{','.join(row)}\n" for row in damaged))
        with pytest.raises(TaxelError) as told:
            read_recording(whole)
        assert str(told.value).removeprefix(f"{tmp_path}/") == refused

"""The tables of words, held against the code, and the list of decisions."""

import re
from importlib import import_module
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
ROW = re.compile(r"^\| (?!word |---)(?P<word>[^|]+) \| (?P<meaning>[^|]+) \| (?P<names>[^|]+) \|$")


def words() -> dict[str, list[str]]:
    """The public names of every word."""
    tables = "".join(page.read_text(encoding="utf-8") for page in sorted(DOCS.glob("words*.md")))
    rows = [match for line in tables.splitlines() if (match := ROW.match(line))]
    return {row["word"]: re.findall(r"`([\w.]+)`", row["names"]) for row in rows}


def resolve(name: str) -> object:
    """The object of a dotted name: its longest prefix that is a module, then attributes."""
    parts = name.split(".")
    for split in range(len(parts), 0, -1):
        try:
            found: object = import_module(".".join(parts[:split]))
        except ModuleNotFoundError as error:
            if error.name is None or not name.startswith(error.name):
                raise
            continue
        for part in parts[split:]:
            # A field without a default is no attribute of its class.
            fields = getattr(found, "model_fields", None) or getattr(found, "__dataclass_fields__", {})
            found = fields[part] if part in fields else getattr(found, part)
        return found
    raise ModuleNotFoundError(name)


def test_the_table_has_a_row_for_every_word() -> None:
    found = words()
    assert len(found) >= 40
    assert {"window", "channel", "artifact", "effect", "spread", "group"} <= set(found)


@pytest.mark.parametrize(("word", "names"), words().items(), ids=words().keys())
def test_every_name_of_a_word_exists(word: str, names: list[str]) -> None:
    assert names, f"{word}: no name in code"
    for name in names:
        resolve(name)


def test_the_list_of_decisions_has_every_file_under_its_title() -> None:
    files = sorted((DOCS / "decisions").glob("[0-9]*.md"))
    titles = [(file.name, file.read_text(encoding="utf-8").splitlines()[0]) for file in files]
    index = (DOCS / "decisions" / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| (\d{4}) \| \[(.+)\]\((.+?)\)", index, re.MULTILINE)
    assert [(name, f"# {number} {title}") for number, title, name in listed] == titles
    assert [number for number, _, _ in listed] == [f"{place:04d}" for place in range(1, len(files) + 1)]


def test_a_name_that_does_not_exist_is_found_out() -> None:
    for wrong in ("taxel.windows.Pane", "taxel.panes.Pane", "taxel.windows.Samples.panes"):
        with pytest.raises((AttributeError, ModuleNotFoundError)):
            resolve(wrong)

"""The parts of a Markdown page that are made from JSON files."""

import json
import re
from pathlib import Path
from typing import Any, Final

from taxel.errors import SettingsError
from taxel_bench.report.run_tables import run_tables

_BLOCK: Final = re.compile(r"<!-- bench report (?P<file>\S+) -->\n(?P<body>.*?)<!-- end -->", re.DOTALL)


def rewritten(text: str, folder: Path) -> tuple[str, int]:
    """A page with each of its parts made again, and how many there are.

    Args:
        text: of the page.
        folder: that the names of JSON files are relative to.

    Raises:
        SettingsError: the page has no such part, or a file is no JSON of `bench run`.
    """
    found = _BLOCK.findall(text)
    if not found or len(found) != text.count("<!-- bench report"):
        raise SettingsError(
            "the page: expected parts between '<!-- bench report FILE.json -->' and '<!-- end -->'"
        )
    new = _BLOCK.sub(lambda part: _written(part["file"], folder), text)
    return new, len(found)


def _written(name: str, folder: Path) -> str:
    lines = run_tables(_read(folder / name))
    return "\n".join([f"<!-- bench report {name} -->", "", *lines, "", "<!-- end -->"])


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise SettingsError(f"{path}: no JSON: {error}") from None
    if not isinstance(found, dict) or not {"machine", "results"} <= set(found):
        raise SettingsError(f"{path}: expected the JSON object that bench run --json prints")
    return found

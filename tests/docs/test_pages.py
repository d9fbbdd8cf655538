"""README and docs are followed: their commands and examples run in small, and print what is shown."""

import shutil
from pathlib import Path
from typing import Final

import pytest

from .blocks import ALL, ROOT, blocks
from .following import FOLLOWED, INSTALLING, MEASURING, Follower, compare, in_turn
from .given import CHECKS, PRELUDES, TOGETHER

PYTHON_PAGES: Final = sorted({one.page for one in ALL if one.language == "python"} - TOGETHER)


def _awaited(text: str) -> str:
    lines = "".join(f"    {line}\n" for line in text.splitlines())
    return f"async def example():\n{lines}asyncio.run(example())\n"


@pytest.mark.parametrize("page", PYTHON_PAGES)
def test_python_examples_run(page: str, follower: Follower) -> None:
    """All examples of a page, one after the other, in one program, and what they print."""
    parts = [PRELUDES.get(page, "")]
    for block in blocks(page):
        if block.language == "python":
            parts.append(_awaited(block.text) if "async with" in block.text else block.text)
    follower.python("\n".join([*parts, CHECKS.get(page, "")]), page)
    expected = [block.text for block in blocks(page) if block.language == "output"]
    if expected:
        compare(follower.printed, "".join(expected), page)


@pytest.mark.parametrize("page", in_turn({*FOLLOWED} - {*INSTALLING, *MEASURING}))
def test_a_page_can_be_followed(page: str, follower: Follower, tmp_path: Path) -> None:
    """The commands and examples of a page work one after the other, and print what the page shows."""
    if page == "clients/typescript/README.md":
        _client_for_node(tmp_path)
    follower.follow(page)


def _client_for_node(folder: Path) -> None:
    """A copy of the client, so that the page builds it beside nobody."""
    client = ROOT / "clients" / "typescript"
    if shutil.which("npm") is None or not (client / "node_modules" / "typescript").is_dir():
        pytest.skip("no TypeScript compiler: run npm ci in clients/typescript")
    for name in ("package.json", "tsconfig.json"):
        shutil.copy(client / name, folder)
    shutil.copytree(client / "src", folder / "src")
    (folder / "test").mkdir()
    (folder / "node_modules").symlink_to(client / "node_modules")

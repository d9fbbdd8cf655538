"""Which files of the repository become pages of the site, and where their links lead."""

import re
import shutil
import subprocess
from pathlib import Path

LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)(#[^)]*)?\)")
"""A Markdown link to a file: its path, and its anchor."""

IMAGE = re.compile(r'<img src="(?!https?:|data:)([^"]+)"')
"""A picture that is written in HTML, as one that has a width."""


def gather(root: Path, pages: Path) -> None:
    """Copy all pages, and every file that they link to, to `pages`, in the repository's own folders.

    The top README is the first page. A link to a folder leads to its README, or to a list of its files.
    """
    shutil.rmtree(pages, ignore_errors=True)
    for name in _tracked(root, "*.md"):
        if not name.startswith("models/repository/"):
            target = pages / ("index.md" if name == "README.md" else name)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(_with_links(root / name, root, pages))


def _with_links(page: Path, root: Path, pages: Path) -> str:
    """A page's text. The files that it links to are copied."""

    def follow(link: re.Match[str]) -> str:
        address, target = link[1], (page.parent / link[1]).resolve()
        if target.is_dir():
            address = f"{address.rstrip('/')}/README.md"
            if not (target / "README.md").is_file():
                _list_files(target, root, pages)
        elif target == root / "README.md":
            address = address.removesuffix("README.md") + "index.md"
        elif target.suffix != ".md":
            _copy(target, root, pages)
        return f"]({address}{link[2] or ''})"

    text = page.read_text()
    for image in IMAGE.findall(text):
        _copy((page.parent / image).resolve(), root, pages)
    return LINK.sub(follow, text)


def _list_files(folder: Path, root: Path, pages: Path) -> None:
    relative = folder.relative_to(root)
    names = _tracked(root, f"{relative}/*")
    for name in names:
        _copy(root / name, root, pages)
    lines = [
        f"- [{Path(name).relative_to(relative)}]({Path(name).relative_to(relative)})" for name in names
    ]
    page = pages / relative / "README.md"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text("\n".join([f"# {relative}", "", *lines, ""]))


def _copy(source: Path, root: Path, pages: Path) -> None:
    target = pages / source.relative_to(root)
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


def _tracked(root: Path, pattern: str) -> list[str]:
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", pattern],
        cwd=root,
        check=True,
        capture_output=True,
        text=True,
    )
    return sorted(set(listed.stdout.splitlines()))

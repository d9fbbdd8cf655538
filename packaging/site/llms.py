"""`llms.txt`: every page of the site with its title, for programs that read (llmstxt.org)."""

import shutil
from pathlib import Path
from typing import Final

_FIRST: Final = (
    "> A low-latency inference server, in Python, that plays a BioTac fingertip for robot simulators."
)

_DRAWN: Final = "\n::: "
"""Stands where the build writes from code: the Markdown of such a page says nothing."""


def write_llms(pages: Path, site: Path) -> None:
    """Write `llms.txt` into the site that was built, and beside each page its Markdown, which it links to.

    Pages that the build writes from code are linked to as HTML.
    """
    lines = ["# Taxel", "", _FIRST, "", "## Pages", ""]
    for page in sorted(pages.rglob("*.md")):
        text, place = page.read_text(), page.relative_to(pages)
        title = next((line[2:] for line in text.splitlines() if line.startswith("# ")), page.stem)
        if _DRAWN in text:
            place = place.with_suffix(".html")
        else:
            (site / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(page, site / place)
        lines.append(f"- [{title}]({place.as_posix()})")
    (site / "llms.txt").write_text("\n".join(lines) + "\n")

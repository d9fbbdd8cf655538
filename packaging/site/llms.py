"""`llms.txt`: every page of the site with its title, for programs that read (llmstxt.org)."""

from pathlib import Path

_FIRST = "> A low-latency inference server, in Python, that plays a BioTac fingertip for robot simulators."


def write_llms(pages: Path) -> None:
    """Write `llms.txt` beside the pages: links to their Markdown, which is copied to the site, too."""
    lines = ["# Taxel", "", _FIRST, "", "## Pages", ""]
    for page in sorted(pages.rglob("*.md")):
        title = next(
            (line[2:] for line in page.read_text().splitlines() if line.startswith("# ")), page.stem
        )
        lines.append(f"- [{title}]({page.relative_to(pages)})")
    (pages / "llms.txt").write_text("\n".join(lines) + "\n")

"""The command `bench report`."""

from pathlib import Path
from typing import Annotated

import typer

from taxel.atomic import write_text
from taxel.commands.cli import OUT


def report(
    page: Annotated[Path, typer.Argument(help="A Markdown page with `<!-- bench report FILE.json -->`.")],
) -> None:
    """Write a page's tables again from the JSON of `bench run` that the page names.

    Each table stands between `<!-- bench report FILE.json -->` and `<!-- end -->`; FILE.json is
    relative to the page. The text around stays as it is.
    """
    from taxel_bench.report.page import rewritten

    text = page.read_text(encoding="utf-8")
    new, blocks = rewritten(text, page.parent)
    write_text(page, new)
    state = "as it was" if new == text else "changed"
    OUT.print(
        f"{page}: {blocks} parts written from JSON; the page is {state}.", soft_wrap=True, markup=False
    )

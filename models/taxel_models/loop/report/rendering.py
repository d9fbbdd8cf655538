"""A document as Markdown, with links to its pictures, and as one HTML file that holds them."""

import base64
from pathlib import Path
from typing import Final

from taxel_models.loop.report.document import Document
from taxel_models.templates import render

_TEMPLATES: Final = Path(__file__).parent / "templates"


def markdown(document: Document) -> str:
    """The whole text; pictures are links to the files beside it."""
    return render(_TEMPLATES / "report.md.j2", document=document)


def html(document: Document, pictures: Path) -> str:
    """The whole page: pictures inside it, no scripts, nothing fetched.

    Args:
        pictures: the folder that holds the document's pictures, PNG files.
    """

    def image(file: str) -> str:
        return base64.b64encode((pictures / file).read_bytes()).decode("ascii")

    return render(_TEMPLATES / "report.html.j2", document=document, image=image)

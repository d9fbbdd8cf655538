"""A document as Markdown; pictures are links to the files beside it."""

import re
from typing import Final

from taxel_models.loop.report.document import Block, Document, Heading, Paragraph, Picture, Table

_SPECIAL: Final = re.compile(r"([\\`*|]|<(?=[A-Za-z/!?]))")
"""What Markdown, or a table's row, would take for its own."""


def markdown(document: Document) -> str:
    """The whole text."""
    return "\n\n".join([f"# {_escaped(document.title)}", *map(_block, document.blocks)]) + "\n"


def _block(block: Block) -> str:
    match block:
        case Heading(text):
            return f"## {_escaped(text)}"
        case Paragraph(text):
            return _escaped(text)
        case Picture(file, title, caption):
            return f"![{_escaped(title)}]({file})\n\n{_escaped(caption)}"
        case Table(head, rows):
            lines = [head, ("---",) * len(head), *(tuple(map(_escaped, row)) for row in rows)]
            return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _escaped(text: str) -> str:
    return _SPECIAL.sub(r"\\\1", text)

"""A document as one HTML file: pictures inside it, no scripts, nothing fetched."""

import base64
from html import escape
from pathlib import Path
from typing import Final

from taxel_models.loop.report.document import Block, Document, Heading, Paragraph, Picture, Table

_STYLE: Final = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
  color: #222; background: #fff; }
h2 { margin-top: 2.2rem; border-bottom: 1px solid #ddd; }
h1 + p { background: #f3f6f9; border-left: 4px solid #30638e; padding: .8rem 1rem; }
table { border-collapse: collapse; margin: 1rem 0; display: block; overflow-x: auto; font-size: .92rem; }
th, td { text-align: left; padding: .25rem .8rem; border-bottom: 1px solid #e3e3e3; vertical-align: top; }
figure { margin: 1.2rem 0; }
img { max-width: 100%; height: auto; }
figcaption { color: #555; font-size: .9rem; }
"""


def html(document: Document, pictures: Path) -> str:
    """The whole page.

    Args:
        pictures: the folder that holds the document's pictures, PNG files.
    """
    title = escape(document.title)
    body = "\n".join(_block(block, pictures) for block in document.blocks)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n<h1>{title}</h1>\n{body}\n</body>\n</html>\n"
    )


def _block(block: Block, pictures: Path) -> str:
    match block:
        case Heading(text):
            return f"<h2>{escape(text)}</h2>"
        case Paragraph(text):
            return f"<p>{escape(text)}</p>"
        case Picture(file, title, caption):
            data = base64.b64encode((pictures / file).read_bytes()).decode("ascii")
            image = f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">'
            return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"
        case Table(head, rows):
            lines = [_row(head, "th"), *(_row(row, "td") for row in rows)]
            return "<table>\n" + "\n".join(lines) + "\n</table>"


def _row(cells: tuple[str, ...], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"

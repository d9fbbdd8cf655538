"""A report's parts in order, before they are written as Markdown or HTML."""

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Heading:
    """Opens a section."""

    kind: ClassVar = "heading"
    text: str


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    kind: ClassVar = "paragraph"
    text: str


@dataclass(frozen=True)
class Note:
    """Lines that stand out."""

    kind: ClassVar = "note"
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """Rows of cells, each as long as the head."""

    kind: ClassVar = "table"
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Picture:
    """A picture beside the text.

    Attributes:
        file: its name in the report's folder.
        title: what it is of, in a few words.
        caption: what it shows and how to read it.
    """

    kind: ClassVar = "picture"
    file: str
    title: str
    caption: str


@dataclass(frozen=True)
class Folded:
    """What a reader opens only if needed."""

    kind: ClassVar = "fold"
    title: str
    blocks: "tuple[Block, ...]"


Block = Heading | Paragraph | Note | Table | Picture | Folded


@dataclass(frozen=True)
class Document:
    """A title and what follows it."""

    title: str
    blocks: tuple[Block, ...]

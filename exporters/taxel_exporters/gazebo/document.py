"""Reads an untrusted YAML file as plain texts, lists and mappings. No tag creates an object.

Only PyYAML's parser is used, which turns text into events, and none of its constructors. Every scalar stays
text; the reader of a value decides its type.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import yaml

from taxel.errors import ArtifactError

MAX_BYTES: Final = 1 << 27
"""The most bytes of a file: four times those of a network with 6 million parameters."""

MAX_VALUES: Final = 1_000_000
"""The most values in a document; a value counts for each alias that repeats it."""

MAX_DEPTH: Final = 32
"""The most levels of nested lists and mappings."""

Tree = str | list["Tree"] | dict[str, "Tree"]

_STANDARD: Final = "tag:yaml.org,2002:"
_TAGS: Final = {
    yaml.ScalarEvent: ("str", "int", "float", "bool", "null", "binary", "python/str", "python/unicode"),
    yaml.SequenceStartEvent: ("seq", "python/tuple"),
    yaml.MappingStartEvent: ("map",),
}
"""Tags that only repeat the type of a value; Python 2 wrote those of `python/`."""

_LOADER: Final = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""libyaml's parser where PyYAML was built with it: 30 times as fast, the same events."""


def read_content(path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        ArtifactError: it cannot be read, or is larger than `MAX_BYTES`.
    """
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ArtifactError(f"{path}: {error.strerror or error}") from None
    if len(content) > MAX_BYTES:
        raise ArtifactError(f"{path}: expected at most {MAX_BYTES >> 20} MiB")
    return content


def parse_document(content: bytes, source: str) -> Tree:
    """The single document in a YAML text.

    Args:
        source: its name in messages.

    Raises:
        ArtifactError: it is not YAML, exceeds a limit above, or has a tag, an alias or a key that is not
            in this format. The text names the line and the layer.
    """
    return _Builder(source).build(content)


def layer_label(tree: Tree, position: int) -> str:
    """The name of a layer in messages, by its position in the list from 0: its own name, if known."""
    name: Tree | None = tree
    for key in ("layers", "layers"):
        name = name.get(key) if isinstance(name, dict) else None
    name = name[position] if isinstance(name, list) and position < len(name) else None
    name = name.get("name") if isinstance(name, dict) else None
    return f"layer {short(name)}" if isinstance(name, str) else f"layer {position + 1} of the list"


def short(text: str) -> str:
    """A text of the file as messages quote it."""
    return repr(text if len(text) <= 60 else f"{text[:60]}…")


class _Refused(Exception):
    """The reason why the remaining file is not read."""


@dataclass
class _Open:
    """A list or mapping that has begun and not ended.

    Attributes:
        before: values counted when it began, itself included.
        place: in it, of what was added last: its position or key.
        awaits_value: a key has come, its value has not.
    """

    content: list[Tree] | dict[str, Tree]
    anchor: str | None
    before: int
    place: int | str = -1
    awaits_value: bool = False

    def add(self, value: Tree) -> str | None:
        """Add an element, a key or a key's value; what is wrong with it, if anything."""
        if isinstance(self.content, list):
            self.content.append(value)
            self.place = len(self.content) - 1
        elif self.awaits_value:
            self.content[str(self.place)] = value
            self.awaits_value = False
        else:
            self.place, self.awaits_value = (value if isinstance(value, str) else ""), True
            if not isinstance(value, str):
                return "a key that is no text"
            if value in self.content:
                return f"the key {short(value)} stands twice in one mapping"
        return None


@dataclass
class _Builder:
    """Builds a tree from the parser's events. Values that an alias repeats are shared, not copied.

    After a refused tag or key it continues to read, so that the message can name the layer.
    """

    source: str
    root: Tree | None = None
    open: list[_Open] = field(default_factory=list)
    anchors: dict[str, tuple[Tree, int]] = field(default_factory=dict)
    count: int = 0
    line: int = 0
    fault: tuple[int, int | None, str] | None = None

    def build(self, content: bytes) -> Tree:
        try:
            for event in yaml.parse(content, Loader=_LOADER):
                self.line = event.start_mark.line if event.start_mark else self.line
                self._take(event)
        except _Refused as refused:
            self._note(str(refused))
        except yaml.YAMLError as error:
            self.line = getattr(getattr(error, "problem_mark", None), "line", self.line)
            problem = getattr(error, "problem", None) or str(error).splitlines()[0]
            self._note(f"not YAML: {problem}")
        if self.fault:
            line, position, text = self.fault
            layer = "" if position is None else f"{layer_label(self.root or '', position)}: "
            raise ArtifactError(f"{self.source}: line {line + 1}: {layer}{text}")
        if self.root is None:
            raise ArtifactError(f"{self.source}: empty; expected a YAML mapping")
        return self.root

    def _take(self, event: yaml.Event) -> None:
        if isinstance(event, yaml.DocumentStartEvent) and self.root is not None:
            raise _Refused("a second document; expected one")
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self.anchors:
                raise _Refused(f"alias {short(str(event.anchor))} of nothing that ended before it")
            self._add(*self.anchors[event.anchor])
        elif isinstance(event, yaml.ScalarEvent):
            self._add(event.value, 1)
            if event.anchor:
                self.anchors[event.anchor] = (event.value, 1)
            self._check_tag(event)
        elif isinstance(event, yaml.CollectionStartEvent):
            self._begin(event)
        elif isinstance(event, yaml.CollectionEndEvent):
            ended = self.open.pop()
            if ended.anchor:
                self.anchors[ended.anchor] = (ended.content, self.count - ended.before + 1)

    def _begin(self, event: yaml.CollectionStartEvent) -> None:
        content: list[Tree] | dict[str, Tree] = [] if isinstance(event, yaml.SequenceStartEvent) else {}
        self._add(content, 1)
        if len(self.open) == MAX_DEPTH:
            raise _Refused(f"expected at most {MAX_DEPTH} lists and mappings within each other")
        self.open.append(_Open(content, event.anchor, self.count))
        self._check_tag(event)

    def _add(self, value: Tree, size: int) -> None:
        self.count += size
        if self.count > MAX_VALUES:
            raise _Refused(f"expected at most {MAX_VALUES} values, aliases counted each time")
        if not self.open:
            self.root = value
        elif fault := self.open[-1].add(value):
            self._note(fault)

    def _check_tag(self, event: yaml.ScalarEvent | yaml.CollectionStartEvent) -> None:
        allowed = next(tags for kind, tags in _TAGS.items() if isinstance(event, kind))
        if event.tag not in (None, "!", *(_STANDARD + tag for tag in allowed)):
            self._note(f"tag {short(str(event.tag))} is refused; expected plain texts, lists and mappings")

    def _note(self, text: str) -> None:
        """Keep this fault, if it is the first one."""
        if self.fault is None:
            self.fault = (self.line, self._layer(), text)

    def _layer(self) -> int | None:
        """The position of the layer whose description or weights are being read."""
        match [value.place for value in self.open]:
            case ["layers", "layers", int(position), *_] | ["weights", int(position), *_]:
                return max(position, 0)
        return None

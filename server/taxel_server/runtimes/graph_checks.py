"""What an ONNX file may not hold, seen before anything of it is computed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import onnx
from google.protobuf.message import DecodeError, Message
from onnx import NodeProto, TensorProto

from taxel.errors import ArtifactError

LOOPS: Final = frozenset({"Loop", "Scan", "SequenceMap", "BeamSearch", "GreedySearch", "Sampling"})
"""Operations that repeat a graph. How often may depend on the window, so no trial can tell the time."""


def check_graph(path: Path) -> None:
    """Raise if an ONNX file holds a loop, or keeps its weights in other files.

    Raises:
        ArtifactError: it does, or is no ONNX file.
    """
    try:
        model = onnx.load(path, load_external_data=False)
    except (DecodeError, OSError) as error:
        raise ArtifactError(f"{path}: no ONNX file: {error}") from None
    for part in _parts(model):
        if isinstance(part, NodeProto) and part.op_type in LOOPS:
            raise ArtifactError(f"{path}: node {part.name!r} is a {part.op_type}: expected no loops")
        if isinstance(part, TensorProto) and (
            part.data_location == TensorProto.EXTERNAL or part.external_data
        ):
            raise ArtifactError(
                f"{path}: tensor {part.name!r} lies in another file: expected it in this one"
            )


def _parts(message: Message) -> Iterator[Message]:
    """All messages in a message, at any depth: the parser allows only so many."""
    for field, value in message.ListFields():
        if field.message_type is not None:
            for part in (value,) if isinstance(value, Message) else value:
                yield part
                yield from _parts(part)

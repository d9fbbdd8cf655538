"""Decodes the arrays of a layer; sizes are checked on the text, before anything is allocated."""

import base64
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import ArtifactError
from taxel_exporters.gazebo.document import Tree

_BYTES: Final = 4


def decode_matrix(tree: Tree, rows: int, columns: int, where: str) -> NDArray[np.float32]:
    """A matrix (rows, columns), from a list with one text a row.

    Raises:
        ArtifactError: it has another shape, is damaged, or a value is not finite.
    """
    if not isinstance(tree, list):
        raise ArtifactError(f"{where}: expected a matrix, as a list of {rows} base64 texts")
    if len(tree) != rows:
        raise ArtifactError(f"{where}: {len(tree)} rows: expected {rows}, one for each input")
    texts = [_checked(text, columns, f"{where}, row {number}") for number, text in enumerate(tree, start=1)]
    matrix = np.empty((rows, columns), np.float32)
    for number, text in enumerate(texts):
        matrix[number] = _decoded(text, columns, f"{where}, row {number + 1}")
    return matrix


def decode_vector(tree: Tree, length: int, where: str) -> NDArray[np.float32]:
    """A vector (length,), from one text.

    Raises:
        ArtifactError: it has another length, is damaged, or a value is not finite.
    """
    return _decoded(_checked(tree, length, where), length, where)


def _checked(tree: Tree, length: int, where: str) -> str:
    """A text with the base64 length of so many values, without its line breaks."""
    if not isinstance(tree, str):
        raise ArtifactError(f"{where}: expected a base64 text, found a {type(tree).__name__}")
    text = "".join(tree.split())
    if len(text) not in _lengths(length):
        expected = f"{_lengths(length)[0]} base64 characters, {length} float32 values"
        raise ArtifactError(f"{where}: {len(text)} characters: expected {expected}")
    return text


def _lengths(values: int) -> tuple[int, int]:
    """Characters of so many values, encoded once, or twice.

    Python 3 writes the encoded bytes as `!!binary`, which encodes them again.
    """
    once = _encoded_length(_BYTES * values)
    return once, _encoded_length(once)


def _encoded_length(size: int) -> int:
    return (size + 2) // 3 * 4


def _decoded(text: str, length: int, where: str) -> NDArray[np.float32]:
    try:
        content = base64.b64decode(text, validate=True)
        if len(text) == _lengths(length)[1]:
            content = base64.b64decode(content, validate=True)
    except ValueError as error:
        raise ArtifactError(f"{where}: damaged base64: {error}") from None
    if len(content) != _BYTES * length:
        raise ArtifactError(f"{where}: {len(content)} bytes: expected {_BYTES * length}")
    values = np.frombuffer(content, "<f4").astype(np.float32)
    if not np.isfinite(values).all():
        raise ArtifactError(f"{where}: a weight that is not finite")
    return values

"""Reads a large JSON text with its arrays of numbers set aside: they never become Python objects."""

import mmap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.errors import ArtifactError
from taxel_server.runtimes.compiled.compiling import compiled
from taxel_server.runtimes.trees.decimals import nearest, read_numbers

CHUNK: Final = 1 << 22
"""Bytes of text looked at in one go."""

_QUOTE, _BACKSLASH, _OPEN, _CLOSE, _COMMA = b'"\\[],'
_ZERO: Final = ord("0")


def _flags(characters: bytes) -> NDArray[np.bool_]:
    table = np.zeros(256, dtype=np.bool_)
    table[list(characters)] = True
    return table


_NUMERIC = _flags(b"0123456789+-.eE, \t\r\nNaInfity")
_BLANK = _flags(b" \t\r\n")


@dataclass(frozen=True)
class ScannedText:
    """A JSON text in two parts.

    Attributes:
        text: (bytes,) uint8, the whole text.
        skeleton: the same JSON in which every array of numbers, but for empty ones, is `[i]`, i its place
            in `spans`.
        spans: (arrays, 3) int64, first byte after the bracket, the closing bracket, and the length.
    """

    text: NDArray[np.uint8]
    skeleton: bytes
    spans: NDArray[np.int64]

    @classmethod
    def of(cls, path: Path) -> Self:
        """Scans a file, which is mapped rather than read.

        Raises:
            ArtifactError: the file is missing or empty.
        """
        try:
            with path.open("rb") as file:
                text = np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), dtype=np.uint8)
        except (OSError, ValueError) as error:
            raise ArtifactError(f"{path}: cannot be read: {error}") from error
        pieces, spans = list[bytes](), [np.empty((0, 3), dtype=np.int64)]
        position, in_string, found = 0, False, 0
        piece = np.empty(4 * CHUNK, dtype=np.uint8)
        table = np.empty((CHUNK // 2 + 1, 3), dtype=np.int64)
        while position < len(text):
            position, in_string, length, count = _scan(text, position, in_string, found, piece, table)
            pieces.append(piece[:length].tobytes())
            spans.append(table[:count].copy())
            found += count
        return cls(text, b"".join(pieces), np.concatenate(spans))

    def lengths(self, arrays: Sequence[int]) -> NDArray[np.int64]:
        """How many numbers each of these arrays holds."""
        lengths: NDArray[np.int64] = self.spans[np.asarray(arrays, dtype=np.int64), 2]
        return lengths

    def floats(self, arrays: Sequence[int], name: str) -> NDArray[np.float32]:
        """The numbers of these arrays one after another, each rounded once to float32.

        Raises:
            ArtifactError: something in them, called `name`, is not a number.
        """
        values, odd = self._read(arrays)
        result = values.astype(np.float32)
        for place, start, stop in odd:
            result[place] = nearest(self._token(start, stop, name))
        return result

    def integers(self, arrays: Sequence[int], name: str) -> NDArray[np.int32]:
        """The numbers of these arrays one after another.

        Raises:
            ArtifactError: something in them, called `name`, is not a 32-bit integer.
        """
        values, odd = self._read(arrays)
        for place, start, stop in odd:
            values[place] = float(self._token(start, stop, name))
        with np.errstate(invalid="ignore"):
            result = values.astype(np.int32)
        wrong = np.flatnonzero(result != values)
        if wrong.size:
            raise ArtifactError(f"{name} holds {values[wrong[0]]}: expected 32-bit integers")
        return result

    def _read(self, arrays: Sequence[int]) -> tuple[NDArray[np.float64], list[list[int]]]:
        spans = self.spans[np.asarray(arrays, dtype=np.int64)]
        values = np.empty(spans[:, 2].sum(), dtype=np.float64)
        odd = np.empty((max(16, len(values) // 64), 3), dtype=np.int64)
        count = read_numbers(self.text, spans, values, odd)
        if count > len(odd):
            odd = np.empty((count, 3), dtype=np.int64)
            read_numbers(self.text, spans, values, odd)
        return values, odd[:count].tolist()

    def _token(self, start: int, stop: int, name: str) -> str:
        token = self.text[start:stop].tobytes().decode().strip()
        try:
            float(token)
        except ValueError:
            raise ArtifactError(f"{name} holds {token!r} at byte {start}: expected a number") from None
        return token


@compiled
def _scan(text, position, in_string, found, piece, table):  # type: ignore[no-untyped-def]
    """Copies text to `piece` with number arrays replaced, until a chunk has been looked at."""
    stop = min(position + CHUNK, text.size)
    length, count = 0, 0
    while position < stop:
        byte = text[position]
        piece[length] = byte
        length += 1
        position += 1
        if in_string:
            if byte == _BACKSLASH and position < text.size:
                piece[length] = text[position]
                length += 1
                position += 1
            in_string = byte != _QUOTE
        elif byte == _QUOTE:
            in_string = True
        elif byte == _OPEN:
            end, numbers, blank = position, 0, True
            while end < text.size and _NUMERIC[text[end]]:
                numbers += text[end] == _COMMA
                blank = blank and _BLANK[text[end]]
                end += 1
            # An empty array may be one of anything.
            if end < text.size and text[end] == _CLOSE and not blank:
                table[count, 0], table[count, 1], table[count, 2] = position, end, numbers + 1
                length = _write_integer(piece, length, found + count)
                count += 1
                position = end
    return position, in_string, length, count


@compiled
def _write_integer(piece, length, value):  # type: ignore[no-untyped-def]
    digits = 1
    while value >= 10**digits:
        digits += 1
    for digit in range(digits):
        piece[length + digits - 1 - digit] = _ZERO + value % 10
        value //= 10
    return length + digits

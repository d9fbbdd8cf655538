"""Reads a CSV file of numbers and reports each fault with its line and column."""

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import RecordingError

FIRST_ROW: Final = 2
"""The line of a table's first row: the header is line 1."""

_TIME_LENGTH: Final = 24
"""Room for a time's text. A longer text is too long for an int64."""

_SHOWN: Final = 60
"""An error shows so many letters of a first line that is no header."""

_NUMBER: Final = re.compile(
    r"[ \t]*[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf(inity)?)[ \t]*", re.ASCII | re.IGNORECASE
)


@dataclass(frozen=True)
class TimeColumn:
    """How a table writes its time.

    Attributes:
        name: name of the column.
        expected: the expected text, for errors.
        parse: from text to ns; returns None if the text is not a time. It uses no float: a float64 of
            an epoch time has steps of a quarter of a microsecond.
    """

    name: str
    expected: str
    parse: Callable[[str], int | None]


@dataclass(frozen=True)
class Table:
    """What a CSV file holds.

    Attributes:
        path: the file.
        time_ns: (n,) int64; in file order, not checked.
        columns: every other column by its header name, in file order, each (n,) float64.
        sha256: hash of the file.
    """

    path: Path
    time_ns: NDArray[np.int64]
    columns: Mapping[str, NDArray[np.float64]]
    sha256: str

    def require_finite(self, names: Sequence[str]) -> None:
        """Check that the named columns hold no NaN and no infinity.

        Raises:
            RecordingError: one does; the text names the first by line and column.
        """
        values = np.column_stack([self.columns[name] for name in names])
        faults = np.argwhere(~np.isfinite(values))
        if len(faults):
            row, column = faults[0]
            raise _fault(
                self.path,
                int(row) + FIRST_ROW,
                f"column {names[column]!r}: {values[row, column]} is not finite; expected a finite number",
            )

    def require_increasing(self) -> None:
        """Check that time goes forward from row to row.

        Raises:
            RecordingError: it does not; the text names the first such line.
        """
        faults = np.flatnonzero(np.diff(self.time_ns) <= 0)
        if len(faults):
            row = int(faults[0]) + 1
            raise _fault(
                self.path,
                row + FIRST_ROW,
                f"time {self.time_ns[row]} ns follows {self.time_ns[row - 1]} ns; "
                "expected time to increase from line to line",
            )


def read_table(
    path: Path, time: TimeColumn, required: Sequence[str], *, loose_commas: bool = False
) -> Table:
    """Read a CSV file of one time column and numbers.

    Args:
        path: the file.
        time: how the time column is called and written.
        required: the columns that have to be there besides time; others are read as well.
        loose_commas: whether a line may end in a comma.

    Raises:
        RecordingError: unreadable, empty, not UTF-8, a column missing or named twice, a line with
            another number of columns, text that is not a number. NaN and infinity are numbers here.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}; expected a CSV file") from None
    text = _decode(path, data)
    if loose_commas:
        text = text.replace(",\n", "\n").replace(",\r\n", "\r\n").removesuffix(",")
    header, *lines = text.rstrip().split("\n")
    names = _columns(path, header, [time.name, *required])
    if not lines:
        raise _fault(path, FIRST_ROW, "the file ends after its header; expected at least one row")
    rows = _parse(names, time, lines)
    if rows is None:
        raise _first_fault(path, names, time, lines)
    times, columns = rows
    return Table(path, times, columns, hashlib.sha256(data).hexdigest())


def _decode(path: Path, data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise _fault(path, line, f"byte {data[error.start]:#04x} is not UTF-8; expected text") from None


def _columns(path: Path, header: str, required: Sequence[str]) -> list[str]:
    if not header.strip():
        raise _fault(path, 1, f"empty; expected a header with the columns {', '.join(required)}")
    # Some programs write names in quotes.
    names = [name.strip().removeprefix('"').removesuffix('"') for name in header.split(",")]
    missing = [name for name in required if name not in names]
    if len(missing) == len(required):
        raise _fault(path, 1, f"begins {header.strip()[:_SHOWN]!r}: {_expected(header, required)}")
    if missing:
        raise _fault(path, 1, f"no column {', '.join(map(repr, missing))}; expected {', '.join(required)}")
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise _fault(path, 1, f"column {repeated[0]!r} stands there twice; expected each name once")
    if "" in names:
        raise _fault(path, 1, f"column {names.index('') + 1} has no name; expected one for each column")
    return names


def _expected(header: str, required: Sequence[str]) -> str:
    if header.lstrip().startswith("#"):
        return "expected the names of the columns in the first line, and no comment"
    if ";" in header or "\t" in header:
        return "expected commas between the columns, and points in numbers"
    return f"expected a header with the columns {', '.join(required)}"


def _parse(
    names: Sequence[str], time: TimeColumn, lines: Sequence[str]
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]] | None:
    """Parse all lines at C speed; None if anything is wrong."""
    dtype = [(name, f"U{_TIME_LENGTH}" if name == time.name else "f8") for name in names]
    try:
        rows = np.loadtxt(lines, dtype=dtype, delimiter=",", comments=None, ndmin=1)
    except ValueError:
        return None
    if len(rows) != len(lines):  # loadtxt ignores empty lines
        return None
    times = [time.parse(text) for text in rows[time.name].tolist()]
    exact = [value for value in times if value is not None and abs(value) < 2**63]
    if len(exact) != len(rows):
        return None
    columns = {name: np.ascontiguousarray(rows[name]) for name in names if name != time.name}
    return np.array(exact, np.int64), columns


def _first_fault(
    path: Path, names: Sequence[str], time: TimeColumn, lines: Sequence[str]
) -> RecordingError:
    """Find the first fault, line by line."""
    for line, row in enumerate(lines, FIRST_ROW):
        fields = row.rstrip("\r").split(",")
        if len(fields) != len(names):
            return _fault(path, line, f"{len(fields)} columns; expected {len(names)}, as in the header")
        for name, field in zip(names, fields, strict=True):
            if name == time.name:
                value = time.parse(field)
                if value is None or abs(value) >= 2**63:
                    return _fault(
                        path, line, f"column {name!r}: {field!r} is not a time; expected {time.expected}"
                    )
            elif not _NUMBER.fullmatch(field):
                return _fault(
                    path, line, f"column {name!r}: {field!r} is not a number; expected a finite number"
                )
    return RecordingError(f"{path}: cannot be read as a table; expected {len(names)} columns of numbers")


def _fault(path: Path, line: int, text: str) -> RecordingError:
    return RecordingError(f"{path}:{line}: {text}")

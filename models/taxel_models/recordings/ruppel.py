"""The Ruppel CSV format: the paper's data set as published, and our interchange format."""

import re
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.atomic import whole_file
from taxel.channels import CHANNELS, ELECTRODES
from taxel.errors import RecordingError, SettingsError
from taxel.windows import Samples
from taxel_models.recordings.csv_table import TimeColumn, read_table
from taxel_models.recordings.recording import AUXILIARY, Recording

TIME: Final = "%time"
POSITION: Final = tuple(f"field.position.{axis}" for axis in "xyz")
FORCE: Final = tuple(f"field.wrench.force.{axis}" for axis in "xyz")
_TACTILE: Final = {name: f"field.tactiles0.{name}" for name in ("pac0", "pac1", "pdc", "tac", "tdc")}
_ELECTRODE: Final = {name: f"field.tactiles0.electrodes{index}" for index, name in enumerate(ELECTRODES)}
_HEADER_OF: Final = {**_TACTILE, **_ELECTRODE}

COLUMNS: Final = (TIME, *POSITION, *FORCE, *_TACTILE.values(), *_ELECTRODE.values())
"""The 31 columns, in the order in which they are written; read in any order."""

_INTEGER: Final = re.compile(r"[+-]?\d{1,19}", re.ASCII)
_WHOLE_MAX: Final = 2.0**53
"""The largest number up to which float64 holds every whole number."""


def _integer_ns(text: str) -> int | None:
    return int(text) if _INTEGER.fullmatch(text) else None


_CLOCK: Final = TimeColumn(TIME, "a whole number of ns, as int64", _integer_ns)


def read_ruppel(path: Path) -> Recording:
    """Read a Ruppel CSV file; columns beyond the 31 become covariates.

    Raises:
        RecordingError: the file is damaged; the text names the file, the line and what was expected.
    """
    table = read_table(path, _CLOCK, COLUMNS[1:])
    table.require_finite(list(table.columns))
    table.require_increasing()
    columns = table.columns
    return Recording.of(
        table.time_ns,
        np.column_stack([columns[name] for name in POSITION]),
        np.column_stack([columns[name] for name in FORCE]),
        np.column_stack([columns[_HEADER_OF[name]] for name in CHANNELS]),
        {name: columns[_HEADER_OF[name]] for name in AUXILIARY},
        {name: values for name, values in columns.items() if name not in COLUMNS},
        name=path.stem,
        format="ruppel",
        sha256=table.sha256,
    )


def has_channels(path: Path) -> bool:
    """Whether a CSV file has a sensor's column; then `read_ruppel` should read it.

    Raises:
        RecordingError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return b"field.tactiles0." in file.readline()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}; expected a CSV file") from None


def read_contacts(path: Path) -> Samples:
    """Read positions and forces from a CSV file without a sensor's columns.

    Raises:
        RecordingError: the file is damaged; the text names the file, the line and what was expected.
    """
    table = read_table(path, _CLOCK, (*POSITION, *FORCE))
    table.require_finite([*POSITION, *FORCE])
    table.require_increasing()
    position, force = (
        np.column_stack([table.columns[name] for name in names]) for names in (POSITION, FORCE)
    )
    return Samples.of(table.time_ns, position, force)


def write_ruppel(recording: Recording, path: Path) -> None:
    """Write a recording as Ruppel CSV, so that `read_ruppel` gives back equal columns.

    The file appears whole or not at all. After an error, an earlier file at `path` is unchanged.

    Raises:
        RecordingError: there are no rows, or a covariate has a name that a header cannot hold.
        SettingsError: `path` cannot be written.
    """
    lines = _lines(recording, path)
    try:
        with whole_file(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
            file.writelines(f"{line}\n" for line in lines)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be written: {error.strerror}") from None


def _lines(recording: Recording, path: Path) -> list[str]:
    if not len(recording):
        raise RecordingError(f"{path}: {recording.name} has no rows; expected at least one to write")
    for name in recording.covariates:
        if name in COLUMNS or not _is_header_name(name):
            raise RecordingError(
                f"{path}: covariate {name!r} cannot be a column's name; expected printable text without "
                "commas, quotes and outer blanks, and none of the 31 names"
            )
    samples = recording.samples
    by_name = {**dict(zip(CHANNELS, recording.channels.T, strict=True)), **recording.auxiliary}
    measured = [*samples.position.T, *samples.force.T, *(by_name[name] for name in _HEADER_OF)]
    header = ",".join([*COLUMNS, *recording.covariates])
    texts = [map(str, samples.time_ns.tolist())]
    texts += [_texts(column) for column in [*measured, *recording.covariates.values()]]
    return [header, *map(",".join, zip(*texts, strict=True))]


def _is_header_name(name: str) -> bool:
    return bool(name) and name.isprintable() and name == name.strip() and not set(',"') & set(name)


def _texts(column: NDArray[np.float64]) -> "map[str]":
    """The shortest texts that read back as the same numbers; without a point if all are whole."""
    whole = (np.abs(column) <= _WHOLE_MAX) & (column == np.rint(column))
    negative_zero = (column == 0) & np.signbit(column)
    if (whole & ~negative_zero).all():
        return map(str, column.astype(np.int64).tolist())
    return map(repr, column.tolist())

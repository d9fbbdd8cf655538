"""The BioTac slide format: a folder of trials, each one tactile and three robot streams."""

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS, ELECTRODES
from taxel.errors import RecordingError
from taxel.windows.samples import GAP_NS
from taxel_models.recordings.alignment import bracket_s, interpolated
from taxel_models.recordings.csv_table import Table, TimeColumn, read_table
from taxel_models.recordings.glitches import glitches
from taxel_models.recordings.recording import AUXILIARY, Recording

OUTSIDE: Final = "outside the robot streams"
GLITCH: Final = "electrode glitch"

STREAMS: Final[Mapping[str, tuple[str, ...]]] = {
    "cp": ("posx", "posy", "posz"),
    "cw": ("fx", "fy", "fz"),
    "cv": ("x", "y", "z"),
}
"""The robot streams and the columns that are read: position, wrench's force, velocity."""

_AUXILIARY_OF: Final = {"pac1": "pac2", "tac": "tac", "tdc": "tdc"}
_CHANNEL_OF: Final = {
    "pac0": "pac1",
    "pdc": "pdc",
    **{name: f"ele{number}" for number, name in enumerate(ELECTRODES, 1)},
}
_TACTILE: Final = (*(_CHANNEL_OF[name] for name in CHANNELS), *(_AUXILIARY_OF[name] for name in AUXILIARY))
_FILE: Final = re.compile(r"mat(\d+)_(\d+)_(bio|cp|cv|cw)\.csv")
_STAMP: Final = re.compile(r"(\d{1,10})\.(\d{9})", re.ASCII)


def _stamp_ns(text: str) -> int | None:
    match = _STAMP.fullmatch(text)
    return int(match[1] + match[2]) if match else None


_CLOCK: Final = TimeColumn("timestamp", "seconds with nine decimal digits", _stamp_ns)


@dataclass(frozen=True)
class Trial:
    """The place of one trial's files.

    Attributes:
        folder: holds its four files.
        material: number of the material.
        number: number of the trial on this material.
    """

    folder: Path
    material: int
    number: int

    def path(self, stream: str) -> Path:
        """The file of one stream: `bio`, `cp`, `cv` or `cw`."""
        return self.folder / f"mat{self.material}_{self.number}_{stream}.csv"


@dataclass(frozen=True)
class _Rows:
    """The kept rows of one trial, and the number of dropped rows."""

    time_ns: NDArray[np.int64]
    tactile: NDArray[np.float64]
    robot: NDArray[np.float64]
    robot_gap: NDArray[np.float64]
    trial: Trial
    hashes: Mapping[Path, str]
    dropped: Counter[str]


def find_trials(folder: Path) -> list[Trial]:
    """The trials whose files lie in `folder` or in its `matM` subfolders, by material and number."""
    paths = [*folder.glob("mat*_*_*.csv"), *folder.glob("mat*/mat*_*_*.csv")]
    found = ((path.parent, _FILE.fullmatch(path.name)) for path in paths)
    trials = {Trial(parent, int(match[1]), int(match[2])) for parent, match in found if match}
    return sorted(trials, key=lambda trial: (trial.material, trial.number, trial.folder))


def read_slide(folder: Path, progress: Callable[[int, int], None] | None = None) -> Recording:
    """Read a folder of trials; each becomes a segment, in the order of their start times.

    The tactile stream's clock is the recording's. Position, force and velocity are interpolated
    to it linearly and keep the frames they were published in: position and force the robot's base
    frame, not the sensor's. Rows before or after the robot streams and rows with an electrode
    glitch are dropped and counted. Covariates: `material`, `trial`, `velocity_x`, `velocity_y`,
    `velocity_z` (m/s), and `robot_gap` (s): the time between the two robot messages that a row
    was interpolated from, in whichever of the three streams it is longest.

    Args:
        folder: holds `matM` folders, or the files of one or more trials.
        progress: called after each trial with the number read and the number in all.

    Raises:
        RecordingError: no trials, a stream missing, a damaged file, or trials that overlap.
    """
    trials = find_trials(folder)
    if not trials:
        raise RecordingError(
            f"{folder}: no trials; expected files like mat1_1_bio.csv or mat1/mat1_1_bio.csv"
        )
    parts = []
    for count, trial in enumerate(trials, 1):
        parts.append(_read_trial(trial))
        if progress:
            progress(count, len(trials))
    parts.sort(key=lambda rows: int(rows.time_ns[0]))
    _require_apart(parts)
    return _joined(folder, parts)


def _read_trial(trial: Trial) -> _Rows:
    tactile = _read_stream(trial, "bio", _TACTILE)
    robot = {stream: _read_stream(trial, stream, columns) for stream, columns in STREAMS.items()}
    time = tactile.time_ns
    inside = (time >= max(table.time_ns[0] for table in robot.values())) & (
        time <= min(table.time_ns[-1] for table in robot.values())
    )
    counts = np.column_stack([tactile.columns[name] for name in _TACTILE])
    glitch = glitches(counts[:, ELECTRODE_COLUMNS])
    keep = inside & ~glitch
    if not keep.any():
        raise RecordingError(
            f"{tactile.path}: all {len(time)} rows are {OUTSIDE} or hold a glitch; "
            "expected four streams of the same time"
        )
    gaps = np.column_stack([bracket_s(time[keep], table.time_ns) for table in robot.values()])
    tables = (tactile, *robot.values())
    return _Rows(
        time[keep],
        counts[keep],
        np.column_stack(
            [
                interpolated(
                    time[keep],
                    table.time_ns,
                    np.column_stack([table.columns[name] for name in STREAMS[stream]]),
                )
                for stream, table in robot.items()
            ]
        ),
        gaps.max(axis=1),
        trial,
        {table.path: table.sha256 for table in tables},
        Counter({OUTSIDE: int((~inside).sum()), GLITCH: int((inside & glitch).sum())}),
    )


def _read_stream(trial: Trial, stream: str, columns: Sequence[str]) -> Table:
    path = trial.path(stream)
    if not path.exists():
        raise RecordingError(
            f"{path}: missing; expected four files a trial: {', '.join(('bio', *STREAMS))}"
        )
    table = read_table(path, _CLOCK, columns, loose_commas=True)
    table.require_finite(columns)
    table.require_increasing()
    return table


def _require_apart(parts: Sequence[_Rows]) -> None:
    for part, next_part in pairwise(parts):
        gap = int(next_part.time_ns[0] - part.time_ns[-1])
        if gap <= GAP_NS:
            raise RecordingError(
                f"{next_part.trial.path('bio')}: starts {gap / 1e9:.3f} s after the end of "
                f"{part.trial.path('bio').name}; expected trials more than {GAP_NS / 1e9} s apart"
            )


def _joined(folder: Path, parts: Sequence[_Rows]) -> Recording:
    tactile = np.concatenate([rows.tactile for rows in parts])
    robot = np.concatenate([rows.robot for rows in parts])
    lengths = [len(rows.time_ns) for rows in parts]
    covariates = {
        "material": np.repeat([float(rows.trial.material) for rows in parts], lengths),
        "trial": np.repeat([float(rows.trial.number) for rows in parts], lengths),
        **{f"velocity_{axis}": robot[:, 6 + index] for index, axis in enumerate("xyz")},
        "robot_gap": np.concatenate([rows.robot_gap for rows in parts]),
    }
    dropped = sum((rows.dropped for rows in parts), Counter[str]())
    return Recording.of(
        np.concatenate([rows.time_ns for rows in parts]),
        robot[:, :3],
        robot[:, 3:6],
        tactile[:, : len(CHANNELS)],
        dict(zip(AUXILIARY, tactile[:, len(CHANNELS) :].T, strict=True)),
        covariates,
        name=folder.resolve().name,
        format="biotac_slide",
        sha256=_sha256(folder, parts),
        dropped=dict(dropped),
    )


def _sha256(folder: Path, parts: Sequence[_Rows]) -> str:
    """Hash of the files' names within the folder and of their hashes, in the order of the names."""
    hashes = {
        path.relative_to(folder).as_posix(): value for rows in parts for path, value in rows.hashes.items()
    }
    return hashlib.sha256(
        "".join(f"{name} {hashes[name]}\n" for name in sorted(hashes)).encode()
    ).hexdigest()

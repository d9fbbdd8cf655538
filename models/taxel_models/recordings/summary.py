"""A summary of a recording in numbers."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.input_checks import Finding
from taxel_models.recordings.findings import recording_findings
from taxel_models.recordings.recording import Recording

UNITS: Final = {
    "position": "m",
    "force": "N",
    "channels": "counts",
    "auxiliary": "counts",
    "covariates": "",
}
"""The groups of columns, in the order of a summary, and their unit."""


@dataclass(frozen=True)
class ColumnStatistics:
    """Statistics of one column's values, in the column's unit.

    Attributes:
        minimum: smallest value.
        mean: of all values.
        maximum: largest value.
        sd: standard deviation of all values.
        repeats: share of the rows, without each segment's first, with exactly the value of the row
            before. It shows slow and held signals; a stuck signal has 1.
    """

    minimum: float
    mean: float
    maximum: float
    sd: float
    repeats: float

    @classmethod
    def of(cls, values: NDArray[np.float64], follows: NDArray[np.int64]) -> Self:
        """Over `values`, (n,) with n of at least 1; `follows` are the rows with a row before them."""
        repeated = values[follows] == values[follows - 1]
        return cls(
            minimum=float(values.min()),
            mean=float(values.mean()),
            maximum=float(values.max()),
            sd=float(values.std()),
            repeats=float(repeated.mean()) if len(repeated) else 0.0,
        )


@dataclass(frozen=True)
class Summary:
    """What `taxel recording` prints.

    Attributes:
        name: name of the recording.
        format: `ruppel`, `biotac_slide`, `ros_bag` or `twin`.
        sha256: hash of the files.
        rows: samples kept.
        segments: stretches without a gap.
        seconds: length of all segments together.
        rate_hz: rate that follows from the median interval between rows.
        dropped: rows left out while reading, by reason.
        columns: statistics by group (the keys of `UNITS`) and column name.
        findings: what looks wrong.
    """

    name: str
    format: str
    sha256: str
    rows: int
    segments: int
    seconds: float
    rate_hz: float
    dropped: Mapping[str, int]
    columns: Mapping[str, Mapping[str, ColumnStatistics]]
    findings: tuple[Finding, ...]


def summarise(recording: Recording) -> Summary:
    """Summarise a recording of at least one row."""
    samples = recording.samples
    groups: dict[str, Iterable[tuple[str, NDArray[np.float64]]]] = {
        "position": zip("xyz", samples.position.T, strict=True),
        "force": [
            *zip(("fx", "fy", "fz"), samples.force.T, strict=True),
            ("|f|", np.linalg.norm(samples.force, axis=1)),
        ],
        "channels": zip(CHANNELS, recording.channels.T, strict=True),
        "auxiliary": recording.auxiliary.items(),
        "covariates": recording.covariates.items(),
    }
    time = samples.time_ns
    starts = [segment.start for segment in recording.segments]
    follows = np.delete(np.arange(len(recording)), starts)
    return Summary(
        name=recording.name,
        format=recording.format,
        sha256=recording.sha256,
        rows=len(recording),
        segments=len(recording.segments),
        seconds=sum(int(time[segment.stop - 1] - time[segment.start]) for segment in recording.segments)
        / 1e9,
        rate_hz=1e9 / samples.period_ns,
        dropped=dict(recording.dropped),
        columns={
            group: {name: ColumnStatistics.of(values, follows) for name, values in columns}
            for group, columns in groups.items()
        },
        findings=tuple(recording_findings(recording)),
    )

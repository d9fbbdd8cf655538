"""A recording: samples over time with the channels that a real or simulated sensor measured."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taxel.channels import CHANNELS
from taxel.errors import InvalidArgument, RecordingError
from taxel.windows import Samples, resample

AUXILIARY: Final = ("pac1", "tac", "tdc")
"""Measured in addition to the 21 channels: second vibration sample, heat flow, temperature."""


@dataclass(frozen=True)
class Recording:
    """Samples, measured channels, and everything else that was recorded.

    Attributes:
        samples: n rows of time, contact position and force.
        channels: (n, 21) float64, counts, columns as `CHANNELS`.
        auxiliary: `pac1`, `tac` and `tdc`, each (n,) float64, counts.
        covariates: any other column by name, each (n,) float64.
        name: its name in tables and errors.
        format: `ruppel`, `biotac_slide`, `ros_bag` or `twin`.
        sha256: hash of the files it was read from; empty if it was made in memory.
        dropped: how many rows were left out while reading, by reason.
    """

    samples: Samples
    channels: NDArray[np.float64]
    auxiliary: Mapping[str, NDArray[np.float64]]
    covariates: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    name: str = "recording"
    format: str = "ruppel"
    sha256: str = ""
    dropped: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = len(self.samples)
        auxiliary = {name: self.auxiliary.get(name, np.empty(0)) for name in AUXILIARY}
        columns: dict[str, tuple[NDArray[np.float64], tuple[int, ...]]] = {
            "channels": (self.channels, (rows, len(CHANNELS))),
            **{name: (values, (rows,)) for name, values in {**auxiliary, **self.covariates}.items()},
        }
        for name, (values, shape) in columns.items():
            if values.shape != shape:
                raise RecordingError(f"{self.name}: {name} has shape {values.shape}: expected {shape}")
            if not np.isfinite(values).all():
                row = int(np.argwhere(~np.isfinite(values))[0, 0])
                raise RecordingError(f"{self.name}: {name} is not finite in row {row}")

    @classmethod
    def of(
        cls,
        time_ns: ArrayLike,
        position: ArrayLike,
        force: ArrayLike,
        channels: ArrayLike,
        auxiliary: Mapping[str, ArrayLike],
        covariates: Mapping[str, ArrayLike] | None = None,
        *,
        name: str = "recording",
        format: str = "ruppel",  # noqa: A002
        sha256: str = "",
        dropped: Mapping[str, int] | None = None,
    ) -> Self:
        """Check and wrap raw columns.

        Raises:
            RecordingError: shapes disagree, a value is not finite or time does not increase.
        """
        try:
            samples = Samples.of(time_ns, position, force)
        except InvalidArgument as error:
            raise RecordingError(f"{name}: {error}") from None
        for what, columns in (("auxiliary", auxiliary), ("covariates", covariates or {})):
            if not isinstance(columns, Mapping):
                raise RecordingError(
                    f"{name}: {what} is a {type(columns).__name__}: expected columns by name, such as "
                    "{'tdc': values}"
                )
        return cls(
            samples,
            _floats(channels),
            {key: _floats(column) for key, column in auxiliary.items()},
            {key: _floats(column) for key, column in (covariates or {}).items()},
            name=name,
            format=format,
            sha256=sha256,
            dropped=dict(dropped or {}),
        )

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def segments(self) -> tuple[slice, ...]:
        """Stretches without a gap; in trial-wise data each is a trial."""
        return self.samples.segments

    @property
    def fingerprint(self) -> str:
        """The sha256 of the files it was read from, or of its columns if it was made in memory."""
        if self.sha256:
            return self.sha256
        digest = hashlib.sha256(self.samples.time_ns.tobytes())
        for column in (
            self.samples.position,
            self.samples.force,
            self.channels,
            *self.auxiliary.values(),
            *self.covariates.values(),
        ):
            digest.update(np.ascontiguousarray(column).tobytes())
        return digest.hexdigest()

    def rows(self, keep: NDArray[np.bool_] | NDArray[np.int64] | slice) -> Self:
        """A recording of some of the rows, in their order. A gap opens where rows are left out."""
        samples = replace(
            self.samples,
            time_ns=self.samples.time_ns[keep],
            position=self.samples.position[keep],
            force=self.samples.force[keep],
        )
        return replace(
            self,
            samples=samples,
            channels=self.channels[keep],
            auxiliary={name: column[keep] for name, column in self.auxiliary.items()},
            covariates={name: column[keep] for name, column in self.covariates.items()},
        )

    def ticks(self) -> Self:
        """This recording at 10 ms ticks: itself if its rows are ticks, else interpolated."""
        if self.samples.are_ticks:
            return self
        names = [*self.auxiliary, *self.covariates]
        columns = [*self.auxiliary.values(), *self.covariates.values()]
        _, values = resample(self.samples, np.column_stack([self.channels, *columns]))
        split = len(CHANNELS)
        extra = dict(zip(names, values[:, split:].T, strict=True))
        return replace(
            self,
            samples=self.samples.ticks(),
            channels=values[:, :split],
            auxiliary={name: extra[name] for name in self.auxiliary},
            covariates={name: extra[name] for name in self.covariates},
        )


def _floats(column: ArrayLike) -> NDArray[np.float64]:
    return np.ascontiguousarray(column, dtype=np.float64)

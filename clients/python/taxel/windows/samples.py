"""Samples of a contact over time, and their resampling to the 10 ms ticks that windows take."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taxel.arguments import checked_rate
from taxel.errors import InvalidArgument
from taxel.windows.combinations import PERIOD_NS

GAP_NS: Final = 50_000_000
"""A segment ends where two samples are further apart than this (or 2.5 periods, if more)."""

_TICK_TOLERANCE: Final = 0.05
"""Rows whose median interval is within 5 % of a tick are ticks as they stand."""


def period_of(rate_hz: float) -> int:
    """Nanoseconds between samples at `rate_hz`.

    Raises:
        InvalidArgument: as `checked_rate`.
    """
    return round(1e9 / checked_rate(rate_hz))


def gap_of(period_ns: int) -> int:
    """The interval, ns, above which samples of this period belong to two segments."""
    return max(GAP_NS, period_ns * 5 // 2)


def rows_are_ticks(period_ns: int) -> bool:
    """Whether samples of this nominal period are used as they stand, without resampling."""
    return abs(period_ns - PERIOD_NS) <= _TICK_TOLERANCE * PERIOD_NS


class SampledSteps(NamedTuple):
    """Which steps of a simulation become samples.

    Where ticks fall on steps, the steps between them change no window, and are left out.

    Attributes:
        least_ns: a step that comes no later than this after the last sample is left out.
        first_ns: for how long the first sample stands.
    """

    least_ns: int
    first_ns: int

    @classmethod
    def of(cls, rate_hz: float) -> Self:
        """Of a simulation that steps at this rate."""
        step_ns = period_of(rate_hz)
        on_steps = PERIOD_NS % step_ns == 0
        return cls(PERIOD_NS - step_ns // 2, PERIOD_NS) if on_steps else cls(0, step_ns)


@dataclass(frozen=True)
class Samples:
    """Where a fingertip is touched and with what force, over time.

    Attributes:
        time_ns: (n,) int64, strictly increasing.
        position: (n, 3) float64, contact position in the sensor's frame, m.
        force: (n, 3) float64, contact force in the sensor's frame, N.
        period_ns: nominal interval between samples.
    """

    time_ns: NDArray[np.int64]
    position: NDArray[np.float64]
    force: NDArray[np.float64]
    period_ns: int

    @classmethod
    def of(
        cls, time_ns: ArrayLike, position: ArrayLike, force: ArrayLike, *, rate_hz: float | None = None
    ) -> "Samples":
        """Check and wrap raw columns; without `rate_hz` the rate is the median interval's.

        Raises:
            InvalidArgument: shapes disagree, a value is not finite or time does not increase.
        """
        time = np.ascontiguousarray(time_ns)
        if time.size and time.dtype.kind not in "iu":
            raise InvalidArgument(f"time_ns is {time.dtype}: expected whole nanoseconds")
        time = time.astype(np.int64, copy=False)
        if time.ndim != 1:
            raise InvalidArgument(f"time_ns has shape {time.shape}: expected one time a sample, (n,)")
        columns = {"position": position, "force": force}
        arrays: dict[str, NDArray[np.float64]] = {}
        for name, values in columns.items():
            array = np.ascontiguousarray(values, dtype=np.float64)
            if array.shape != (len(time), 3):
                raise InvalidArgument(f"{name} has shape {array.shape}: expected ({len(time)}, 3)")
            if not np.isfinite(array).all():
                row = int(np.argmin(np.isfinite(array).all(axis=1)))
                raise InvalidArgument(f"{name}[{row}] is {array[row].tolist()}: expected finite numbers")
            arrays[name] = array
        intervals = np.diff(time)
        if (intervals <= 0).any():
            row = int(np.argmax(intervals <= 0)) + 1
            raise InvalidArgument(f"time_ns[{row}] is {time[row]}, not after {time[row - 1]} before it")
        if rate_hz is not None:
            period = period_of(rate_hz)
        else:
            period = int(np.median(intervals)) if len(intervals) else PERIOD_NS
        return cls(time, arrays["position"], arrays["force"], period)

    def __len__(self) -> int:
        return len(self.time_ns)

    @cached_property
    def segments(self) -> tuple[slice, ...]:
        """Stretches of rows without a gap, in order; together they cover every row."""
        if not len(self):
            return ()
        breaks = np.flatnonzero(np.diff(self.time_ns) > gap_of(self.period_ns)) + 1
        edges = [0, *breaks.tolist(), len(self)]
        return tuple(slice(start, stop) for start, stop in pairwise(edges))

    @property
    def are_ticks(self) -> bool:
        """Whether the rows are 10 ms ticks already."""
        return rows_are_ticks(self.period_ns)

    def ticks(self) -> "Samples":
        """These samples at 10 ms ticks: themselves if they are, else linearly interpolated."""
        if self.are_ticks:
            return self
        time, values = resample(self, np.hstack([self.position, self.force]))
        return Samples(time, values[:, :3].copy(), values[:, 3:].copy(), PERIOD_NS)


def resample(
    samples: Samples, values: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Interpolate columns that belong to `samples` linearly at 10 ms ticks.

    Ticks start at each segment's first sample and never reach beyond its last; a tick that
    falls on a sample takes its value unchanged.

    Args:
        values: (n, k), one row a sample.

    Returns:
        The ticks' times, (m,) ns, and the values there, (m, k).
    """
    parts = list(_resampled_segments(samples, values))
    if not parts:
        return np.empty(0, np.int64), np.empty((0, values.shape[1]))
    times, columns = zip(*parts, strict=True)
    return np.concatenate(times), np.concatenate(columns)


def _resampled_segments(
    samples: Samples, values: NDArray[np.float64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    for segment in samples.segments:
        time, rows = samples.time_ns[segment], values[segment]
        ticks = np.arange(time[0], time[-1] + 1, PERIOD_NS, dtype=np.int64)
        before = np.searchsorted(time, ticks, side="right") - 1
        after = np.minimum(before + 1, len(time) - 1)
        span = np.maximum(time[after] - time[before], 1)
        weight = ((ticks - time[before]) / span)[:, None]
        yield ticks, rows[before] + weight * (rows[after] - rows[before])

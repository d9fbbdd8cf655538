"""Observations: a model's predictions, the measurements, and the other columns of each row."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.corrections import weighted_shape
from taxel.errors import RecordingError
from taxel.manifest import Manifest
from taxel.windows import HistoryFeature, Samples, build_windows, extra_columns, history_columns
from taxel.windows.history import TICK_S, TOUCH_N
from taxel_models.loop.basis import Floats
from taxel_models.loop.limits import Limits
from taxel_models.loop.resting import are_raw, resting
from taxel_models.model import Model, predict_all
from taxel_models.recordings import Recording
from taxel_models.recordings.kinds import NOT_COVARIATES, are_kinds

FEWEST_CONTACTS: Final = 8
"""To tell how far offsets of contacts scatter."""

AIR_TICKS: Final = 10
"""Air between two touches, 0.1 s."""


def runs(numbers: NDArray[np.int64]) -> list[slice]:
    """The rows of each run of equal numbers (n,), such as those of segments, in order."""
    starts = np.flatnonzero(np.diff(numbers, prepend=-1)).tolist()
    return [slice(start, stop) for start, stop in pairwise([*starts, len(numbers)])]


@dataclass(frozen=True)
class TakenCalibration:
    """A calibration at the start of each row's segment, as a user's sensor would give it.

    Attributes:
        offsets: (n, 21) measured less predicted, counts.
        age_s: (n,) how long before the row it ended.
    """

    offsets: Floats
    age_s: Floats

    def kept(self, keep: NDArray[np.bool_]) -> "TakenCalibration":
        """Of some of the rows."""
        return TakenCalibration(self.offsets[keep], self.age_s[keep])


@dataclass(frozen=True)
class Observations:
    """Rows of recordings, each a window's time T, in order.

    Attributes:
        model: that is compared with the measurements.
        windows: (n, f) float32, with the model's own extra features.
        predicted: (n, 21) counts.
        base: (n, 21) what the model file itself gives, from which all terms are computed; differs from
            `predicted` where the model is corrected already.
        measured: (n, 21) counts.
        segment: (n,) number of the segment; numbers run through all recordings.
        time_s: (n,) since the recording's first sample.
        position: (n, 3) m.
        force: (n, 3) N.
        covariates: any other column by name, `tdc` and `tac` among them, each (n,).
        samples: the ticks of each recording, for features of the past.
        rows: for each recording, which of its ticks the rows are.
        withheld: names of the columns that neither the model nor the loop is given.
        shift_ticks: how far the windows were moved into the past.
        calibration: taken at the start of each segment; None where none was.
        known_rest: (21,) in place of what the model gives at rest, counts.
    """

    model: Model
    windows: NDArray[np.float32]
    predicted: Floats
    base: Floats
    measured: Floats
    segment: NDArray[np.int64]
    time_s: Floats
    position: Floats
    force: Floats
    covariates: Mapping[str, Floats]
    samples: tuple[Samples, ...]
    rows: tuple[NDArray[np.int64], ...]
    withheld: tuple[str, ...] = ()
    shift_ticks: int = 0
    calibration: TakenCalibration | None = None
    known_rest: Floats | None = None
    _history: dict[HistoryFeature, Floats] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.predicted)

    @property
    def manifest(self) -> Manifest:
        """The model's."""
        return self.model.manifest

    @cached_property
    def residual(self) -> Floats:
        """(n, 21) measured less predicted, counts."""
        return self.measured - self.predicted

    @cached_property
    def limits(self) -> Limits:
        """Of the channels' counts."""
        return Limits.of(self.measured)

    @cached_property
    def pressed(self) -> Floats:
        """(n,) the force's magnitude, N."""
        return np.asarray(np.linalg.norm(self.force, axis=1))

    @cached_property
    def rest(self) -> Floats:
        """(21,) what the model gives at rest, counts; see `resting`."""
        return resting(self.pressed, self.base) if self.known_rest is None else self.known_rest

    @cached_property
    def signal(self) -> Floats:
        """(n, 21) the model file's counts about rest."""
        return self.base - self.rest

    def seen_as(self, counts: Floats, predicted: Floats, rest: Floats | None) -> "Observations":
        """The same with other counts (n, 21) as the signal, and another prediction (n, 21).

        Args:
            rest: (21,) of the signal; None for what these counts are at rest.
        """
        return replace(self, base=counts, predicted=predicted, known_rest=rest)

    @cached_property
    def log_impedance_slope(self) -> Floats:
        """(n, 21) what the model file's counts change by with ln Z; 1 for `pac0` and `pdc`."""
        return weighted_shape("log_impedance", self.base, self.rest)

    @cached_property
    def raw_counts(self) -> bool:
        """Whether electrodes read impedance: tared magnitudes rest near 0 and stand for none."""
        return are_raw(self.rest)

    def calibrated(self, seconds: float) -> "Observations":
        """The rows after the first seconds of each segment, with the offsets found in those.

        Raises:
            RecordingError: no segment is longer than that.
        """
        since, offsets = np.empty_like(self.time_s), np.empty_like(self.residual)
        for part in runs(self.segment):
            since[part] = self.time_s[part] - self.time_s[part.start]
            offsets[part] = self.residual[part][since[part] < seconds].mean(axis=0)
        early = since < seconds
        if early.all():
            raise RecordingError(f"no segment is longer than the {seconds:g} s of its calibration")
        return replace(self, calibration=TakenCalibration(offsets, since - seconds)).kept(~early)

    def kept(self, keep: NDArray[np.bool_]) -> "Observations":
        """Some of the rows."""
        counts = np.cumsum([0, *map(len, self.rows)])
        parts = [keep[start:stop] for start, stop in pairwise(counts)]
        columns = ("windows", "predicted", "base", "measured", "segment", "time_s")
        fields: dict[str, Any] = {name: getattr(self, name)[keep] for name in columns}
        return replace(
            self,
            **fields,
            position=self.position[keep],
            force=self.force[keep],
            covariates={name: values[keep] for name, values in self.covariates.items()},
            rows=tuple(rows[part] for rows, part in zip(self.rows, parts, strict=True)),
            calibration=None if self.calibration is None else self.calibration.kept(keep),
            _history={},
        )

    @cached_property
    def contact(self) -> NDArray[np.int64]:
        """(n,) number of the contact: a segment; where segments are few, a touch with the air after it."""
        if len(np.unique(self.segment)) >= FEWEST_CONTACTS:
            return self.segment
        begins = np.diff(self.segment, prepend=-1) != 0
        pressed = self.pressed > TOUCH_N
        # A touch after less air than this goes on: a force near the threshold begins no contact.
        calm = ~pressed[self.rows_before(AIR_TICKS)] & ~pressed[self.rows_before(1)]
        return np.asarray(np.cumsum(begins | (pressed & calm)) - 1)

    @cached_property
    def kind_columns(self) -> list[str]:
        """Columns that name at least two kinds, such as materials."""
        return [
            name
            for name, values in self.covariates.items()
            if name not in NOT_COVARIATES and are_kinds(kinds := np.unique(values)) and len(kinds) > 1
        ]

    @cached_property
    def usual_segment_s(self) -> float:
        """The median length of a segment, s."""
        return float(np.median(np.unique(self.segment, return_counts=True)[1])) * TICK_S

    @cached_property
    def usual_travel_n(self) -> float:
        """The median over segments of the difference between the largest and the smallest force, N."""
        starts = np.flatnonzero(np.diff(self.segment, prepend=-1))
        largest = np.maximum.reduceat(self.pressed, starts)
        return float(np.median(largest - np.minimum.reduceat(self.pressed, starts)))

    @cached_property
    def starts_pressed(self) -> bool:
        """Whether enough segments begin with a load. In few, a start from rest looks like a drift."""
        starts = np.diff(self.segment, prepend=-1) != 0
        return int((self.pressed[starts] > TOUCH_N).sum()) >= FEWEST_CONTACTS

    def rows_before(self, ticks: int | NDArray[np.int64]) -> NDArray[np.int64]:
        """(n,) the row so many ticks before each, in its segment; the row itself where there is none.

        Args:
            ticks: of all rows, or of each (n,).
        """
        rows = np.arange(len(self))
        there = np.clip(rows - ticks, 0, len(self) - 1)
        same = self.segment[there] == self.segment
        apart = np.abs((self.time_s - self.time_s[there]) - ticks * TICK_S)
        return np.where(same & (apart < TICK_S / 2), there, rows)

    def with_windows(self, windows: NDArray[np.float32], *, shift_ticks: int) -> "Observations":
        """The same rows, their inputs turned or shifted and predicted anew."""
        predicted, base = _predictions(self.model, windows)
        return replace(self, windows=windows, predicted=predicted, base=base, shift_ticks=shift_ticks)

    def history(self, feature: HistoryFeature) -> Floats:
        """(n,) a feature of the past at each row; built once."""
        if feature not in self._history:
            parts = [
                history_columns(samples, [feature])[rows, 0]
                for samples, rows in zip(self.samples, self.rows, strict=True)
            ]
            self._history[feature] = np.concatenate(parts)
        return self._history[feature]


def gather(
    model: Model, recordings: Sequence[Recording], *, withheld: tuple[str, ...] = ()
) -> Observations:
    """Windows, predictions and measurements of recordings, aligned.

    Args:
        model: is called with up to `ROWS_A_REQUEST` windows.
        withheld: names of columns that the model is not given, nor the loop. A model that takes one of
            them gets the default in its place.

    Raises:
        RecordingError: no recording has a whole window.
    """
    manifest = model.manifest
    ticks = [recording.ticks() for recording in recordings]
    built = [build_windows(recording.samples, manifest.spec) for recording in ticks]
    if not sum(map(len, built)):
        raise RecordingError("the recordings hold no whole window: expected segments of at least 0.3 s")
    rows = tuple(windows.rows for windows in built)
    columns = [
        {
            name: values
            for name, values in {**recording.auxiliary, **recording.covariates}.items()
            if name not in withheld
        }
        for recording in ticks
    ]
    samples = tuple(recording.samples for recording in ticks)
    extras = [
        extra_columns(own, manifest.window.extras, given)[kept]
        for own, given, kept in zip(samples, columns, rows, strict=True)
    ]
    windows = np.concatenate(
        [
            np.column_stack([own.values, extra]).astype(np.float32)
            for own, extra in zip(built, extras, strict=True)
        ]
    )
    predicted, base = _predictions(model, windows)
    names = set.intersection(*map(set, columns)) - {"pac1"}

    def joined(per_tick: Iterable[NDArray[Any]]) -> NDArray[Any]:
        """The kept rows of what each recording has at each of its ticks, one recording after another."""
        return np.concatenate([own[kept] for own, kept in zip(per_tick, rows, strict=True)])

    return Observations(
        model=model,
        windows=windows,
        predicted=predicted,
        base=base,
        measured=joined(recording.channels for recording in ticks),
        segment=_segments(ticks, rows),
        time_s=joined((own.time_ns - own.time_ns[0]) / 1e9 for own in samples),
        position=joined(own.position for own in samples),
        force=joined(own.force for own in samples),
        covariates={name: joined(own[name] for own in columns) for name in sorted(names)},
        samples=samples,
        rows=rows,
        withheld=withheld,
    )


def _predictions(model: Model, windows: NDArray[np.float32]) -> tuple[Floats, Floats]:
    """The model's predictions, and those without its effects, (n, 21) counts each."""
    predicted = predict_all(model.predict, windows)
    return predicted, predict_all(model.predict_base, windows) if model.manifest.effects else predicted


def _segments(recordings: Sequence[Recording], rows: tuple[NDArray[np.int64], ...]) -> NDArray[np.int64]:
    numbers, first = [], 0
    for recording, kept in zip(recordings, rows, strict=True):
        starts = np.array([segment.start for segment in recording.segments])
        numbers.append(first + np.searchsorted(starts, kept, side="right") - 1)
        first += len(starts)
    return np.concatenate(numbers).astype(np.int64)

"""Grounds of real recordings: slide trials over materials, and LASA's presses on a force sensor."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.errors import RecordingError
from taxel.windows import PERIOD_NS
from taxel_models.ground.base_model import BaseModel
from taxel_models.ground.ground import ALL_CHANNELS, Clean, Floats
from taxel_models.recordings import Recording, read_slide
from taxel_models.recordings.lasa import FINGERS, read_lasa_columns
from taxel_models.twin.sensor import Sensor

SLIDE: Final = "biotac_slide"
LASA: Final = "lasa_contact"

HELD_OUT: Final = {SLIDE: 0.35, LASA: 0.5}
"""The share of the trials that a round may draw from."""

PLAYED: Final = {SLIDE: 50, LASA: 20}
"""Trials of a round, at most."""

DRAWN: Final = 0.8
"""The largest share of a session's held-out trials that a round takes, so that rounds differ."""

LEAST_TRIALS: Final = 20
"""A session with fewer held-out trials is not played."""

LEAST_OF_ONE: Final = 5
"""The same where a round plays one kind, such as one of 16 materials."""

MATERIAL: Final = "material"
"""The column of kinds that the slide data have."""

UNSEEN: Final = 0.25
"""The share of a column's values that a model is not trained on."""

PAUSE_S: Final = 4 * 3600.0
"""A longer pause ends a session: the slide data are from three days."""

STRETCH: Final = 500
CUT: Final = 20
"""LASA has no trials: it is cut into stretches of so many rows, and the first of each are left out."""

_NOT_MEASURED: Final = {"pac0": (2040.0, 4.5), "pdc": (1973.0, 1.0)}
"""What stands for LASA's missing channels: mean and SD of an untouched finger, counts."""


def real_data(folder: Path) -> Path:
    """The folder that holds the real recordings: the given one, or its folder `data`."""
    return folder / "data" if (folder / "data").is_dir() else folder


@dataclass(frozen=True)
class Session:
    """Recordings of one finger on one day, or of one kind, with a model that saw neither.

    Attributes:
        played: whole trials; a round takes some of them.
    """

    model: BaseModel
    played: Recording


@dataclass(frozen=True)
class RealGround:
    """Trials of real recordings that the base model was not trained on."""

    sessions: tuple[Session, ...]
    seed: int
    played: int
    on_skin: bool
    live: tuple[bool, ...]

    @classmethod
    def slide(
        cls,
        folder: Path,
        seed: int,
        jobs: int = 1,
        one_of: str | None = None,
        *,
        unseen: bool = False,
        all_days: bool = False,
    ) -> Self:
        """Of the slide data in `folder`/biotac_slide; one model for all days.

        Args:
            one_of: a column, such as `material`: a round plays trials of one of its values.
            unseen: the model is trained on three quarters of the values of `one_of`, and rounds play the
                others; without `one_of`, on three quarters of the materials, and rounds play all of them.
            all_days: a round plays trials of all three days, in place of one; not with `one_of`.

        Raises:
            RecordingError: the data are not there, are damaged, or are too few, or have no such column.
        """
        recording = read_slide(_found(folder / SLIDE))
        if one_of is not None and unseen:
            trained, held_out = _without_some_kinds(recording, one_of, seed)
        else:
            trained, held_out = _divided(recording, seed, HELD_OUT[SLIDE])
            if unseen:
                trained, _ = _without_some_kinds(trained, MATERIAL, seed)
        model = BaseModel.fit(trained, seed, jobs)
        days = [held_out] if all_days else _days(held_out)
        parts = days if one_of is None else _kinds(held_out, one_of)
        least = LEAST_TRIALS if one_of is None else LEAST_OF_ONE
        sessions = tuple(Session(model, part) for part in parts if len(part.segments) >= least)
        if not sessions:
            raise RecordingError(
                f"{folder / SLIDE}: no {one_of or 'day'} has {least} held-out trials; "
                "expected about 60 in all"
            )
        return cls(sessions, seed, PLAYED[SLIDE], False, ALL_CHANNELS)

    @classmethod
    def lasa(cls, folder: Path, seed: int, jobs: int = 1) -> Self:
        """Of the LASA data in `folder`/lasa_contact; a model for each finger.

        Raises:
            RecordingError: the data are not there.
        """
        sessions = []
        for finger in FINGERS:
            recording = read_lasa(_found(folder / LASA), finger, seed)
            trained, held_out = _divided(recording, seed, HELD_OUT[LASA])
            sessions.append(Session(BaseModel.fit(trained, seed, jobs), held_out))
        live = tuple(name not in _NOT_MEASURED for name in CHANNELS)
        return cls(tuple(sessions), seed, PLAYED[LASA], True, live)

    def clean(self, number: int) -> Clean:
        """Some held-out trials of one session, both drawn at random."""
        random = np.random.default_rng([self.seed, number, 1])
        session = self.sessions[int(random.integers(len(self.sessions)))]
        trials = session.played.segments
        drawn = np.sort(random.permutation(len(trials))[: min(self.played, round(DRAWN * len(trials)))])
        recording = _of_trials(session.played, [trials[trial] for trial in drawn])
        contact = np.repeat(
            np.arange(len(recording.segments)), [part.stop - part.start for part in recording.segments]
        )
        model = session.model
        return Clean(
            model, recording, model.reference, self.on_skin, self.live, contact, fitted=model.fitted
        )


def read_lasa(folder: Path, finger: str, seed: int) -> Recording:
    """One finger of the LASA data, `F1` or `F2`, as a recording of stretches of 5 s.

    It has no time stamps, positions or temperature. Rows are taken as 10 ms apart, the temperature as
    constant, `pac0` and `pdc` as noise about a constant. Positions are estimated; see `estimated_place`.

    Raises:
        RecordingError: the files are not there, or hold other than numbers.
    """
    force, electrodes = read_lasa_columns(folder, finger)
    rows = len(force)
    random = np.random.default_rng([seed, 2])
    still = [np.rint(mean + sd * random.standard_normal(rows)) for mean, sd in _NOT_MEASURED.values()]
    recording = Recording.of(
        PERIOD_NS * np.arange(rows, dtype=np.int64),
        estimated_place(electrodes, np.linalg.norm(force, axis=1)),
        force,
        np.clip(np.column_stack([*still, electrodes]), 0, COUNTS_MAX),
        {"pac1": still[0], "tac": np.full(rows, 2250.0), "tdc": np.full(rows, 1968.0)},
        name=f"lasa-{finger}",
        format="lasa_contact",
    )
    return recording.rows(np.arange(rows) % STRETCH >= CUT)


def estimated_place(electrodes: Floats, load: Floats) -> Floats:
    """Where a finger is pressed (n, 3), m, by its electrodes (n, 19) and the load (n,), N.

    The mean of the electrodes' places, weighted by the square of their change since the lightest loads,
    as is usual for contact estimates; smoothed over 0.2 s and moved out to the skin.
    """
    sensor = Sensor.biotac_2p()
    rest = np.median(electrodes[load <= np.quantile(load, 0.02)], axis=0)
    change = uniform_filter1d((electrodes - rest) ** 2, 20, axis=0) + 1.0
    place = change @ sensor.positions / change.sum(axis=1, keepdims=True)
    axis = np.column_stack([np.minimum(place[:, 0], 0.0), np.zeros((len(place), 2))])
    out = place - axis
    return np.asarray((axis + sensor.skin_radius * out / np.linalg.norm(out, axis=1, keepdims=True)) / 1e3)


def _found(folder: Path) -> Path:
    if not folder.is_dir():
        raise RecordingError(
            f"{folder}: no such folder; expected the real recordings (TAXEL_DATA or --data)"
        )
    return folder


def _divided(recording: Recording, seed: int, share: float) -> tuple[Recording, Recording]:
    """Whole trials to train on, and whole trials to play, at ticks."""
    ticks = recording.ticks()
    trials = ticks.segments
    order = np.random.default_rng([seed, 0]).permutation(len(trials))
    held = round(share * len(trials))
    played, trained = np.sort(order[:held]), np.sort(order[held:])
    return _of_trials(ticks, [trials[one] for one in trained]), _of_trials(
        ticks, [trials[one] for one in played]
    )


def _of_trials(recording: Recording, trials: Sequence[slice]) -> Recording:
    keep = np.zeros(len(recording), np.bool_)
    for trial in trials:
        keep[trial] = True
    return replace(recording.rows(keep), sha256="")


def _without_some_kinds(recording: Recording, column: str, seed: int) -> tuple[Recording, Recording]:
    """The trials of most values of a column to train on, and those of the others to play, at ticks."""
    ticks = recording.ticks()
    kinds = _kinds_of_trials(ticks, column)
    values = np.random.default_rng([seed, 3]).permutation(np.unique(kinds))
    new = np.isin(kinds, values[: max(1, round(UNSEEN * len(values)))])
    trained, played = (
        _of_trials(ticks, [ticks.segments[place] for place in np.flatnonzero(some)]) for some in (~new, new)
    )
    return trained, played


def _kinds(recording: Recording, column: str) -> list[Recording]:
    """The trials of each value of a column by themselves."""
    trials, kinds = recording.segments, _kinds_of_trials(recording, column)
    return [
        _of_trials(recording, [trials[place] for place in np.flatnonzero(kinds == kind)])
        for kind in np.unique(kinds)
    ]


def _kinds_of_trials(recording: Recording, column: str) -> Floats:
    """(trials,) the value of a column in each."""
    if column not in recording.covariates:
        known = ", ".join(recording.covariates)
        raise RecordingError(f"no column {column!r} to play one value of; there are: {known}")
    values = recording.covariates[column]
    return np.array([values[trial.start] for trial in recording.segments])


def _days(recording: Recording) -> list[Recording]:
    """A recording cut at its long pauses."""
    pauses: NDArray[np.bool_] = np.diff(recording.samples.time_ns) > PAUSE_S * 1e9
    starts = np.flatnonzero(pauses) + 1
    edges = [0, *starts.tolist(), len(recording)]
    return [recording.rows(slice(start, stop)) for start, stop in pairwise(edges)]

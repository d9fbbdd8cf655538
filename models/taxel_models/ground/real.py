"""Grounds of real recordings: slide trials over materials, and LASA's presses on a force sensor."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.errors import RecordingError
from taxel_models.ground.base_model import BaseModel
from taxel_models.ground.ground import ALL_CHANNELS, Clean, Position
from taxel_models.recordings import Recording, read_slide

SLIDE: Final = "biotac_slide"
LASA: Final = "lasa_contact"
FINGERS: Final = ("F1", "F2")

HELD_OUT: Final = {SLIDE: 0.35, LASA: 0.5}
"""The share of the trials that a round may draw from."""

PLAYED: Final = {SLIDE: 50, LASA: 20}
"""Trials of a round, at most."""

PAUSE_S: Final = 4 * 3600.0
"""A longer pause ends a session: the slide data are from three days."""

PERIOD_NS: Final = 10_000_000
STRETCH: Final = 500
CUT: Final = 20
"""LASA has no trials: it is cut into stretches of so many rows, and the first of each are left out."""

_NOT_MEASURED: Final = {"pac0": (2040.0, 4.5), "pdc": (1973.0, 1.0)}
"""What stands for LASA's missing channels: mean and SD of an untouched finger, counts."""


@dataclass(frozen=True)
class Session:
    """Recordings of one finger on one day, with a model that saw neither.

    Attributes:
        held_out: whole trials that the model was not trained on; a round takes some of them.
        reference: others.
    """

    model: BaseModel
    held_out: Recording
    reference: Recording


@dataclass(frozen=True)
class RealGround:
    """Trials of real recordings that the base model was not trained on."""

    sessions: tuple[Session, ...]
    seed: int
    played: int
    position: Position
    live: tuple[bool, ...]

    @classmethod
    def slide(cls, folder: Path, seed: int, jobs: int = 1) -> Self:
        """Of the slide data in `folder`/biotac_slide; one model for all days.

        Raises:
            RecordingError: the data are not there, or are damaged.
        """
        recording = read_slide(_found(folder / SLIDE))
        trained, held_out = _divided(recording, seed, HELD_OUT[SLIDE])
        model, reference = BaseModel.fit(trained, seed, jobs)
        days = _days(held_out)
        sessions = tuple(Session(model, day, reference) for day in days if len(day.segments) >= 20)
        return cls(sessions, seed, PLAYED[SLIDE], "pose", ALL_CHANNELS)

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
            model, reference = BaseModel.fit(trained, seed, jobs)
            sessions.append(Session(model, held_out, reference))
        live = tuple(name not in _NOT_MEASURED for name in CHANNELS)
        return cls(tuple(sessions), seed, PLAYED[LASA], "none", live)

    def clean(self, number: int) -> Clean:
        """Some held-out trials of one session, both drawn at random."""
        random = np.random.default_rng([self.seed, number, 1])
        session = self.sessions[int(random.integers(len(self.sessions)))]
        trials = session.held_out.segments
        drawn = np.sort(random.permutation(len(trials))[: self.played])
        recording = _of_trials(session.held_out, [trials[trial] for trial in drawn])
        contact = np.repeat(
            np.arange(len(recording.segments)), [part.stop - part.start for part in recording.segments]
        )
        return Clean(session.model, recording, session.reference, self.position, self.live, contact)


def read_lasa(folder: Path, finger: str, seed: int) -> Recording:
    """One finger of the LASA data, `F1` or `F2`, as a recording of stretches of 5 s.

    It has no time stamps, positions or temperature: rows are taken as 10 ms apart, positions and
    temperature as constant. `pac0` and `pdc` are noise about a constant.

    Raises:
        RecordingError: the files are not there.
    """
    try:
        force = np.loadtxt(folder / f"{finger}_force.txt")
        electrodes = np.loadtxt(folder / f"{finger}_electrodes.txt")
    except OSError as error:
        raise RecordingError(f"{folder}: {error}; expected the LASA contact data") from None
    rows = len(force)
    random = np.random.default_rng([seed, 2])
    still = [np.rint(mean + sd * random.standard_normal(rows)) for mean, sd in _NOT_MEASURED.values()]
    recording = Recording.of(
        PERIOD_NS * np.arange(rows, dtype=np.int64),
        np.zeros((rows, 3)),
        force,
        np.clip(np.column_stack([*still, electrodes]), 0, COUNTS_MAX),
        {"pac1": still[0], "tac": np.full(rows, 2250.0), "tdc": np.full(rows, 1968.0)},
        name=f"lasa-{finger}",
        format="lasa_contact",
    )
    return recording.rows(np.arange(rows) % STRETCH >= CUT)


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


def _days(recording: Recording) -> list[Recording]:
    """A recording cut at its long pauses."""
    pauses: NDArray[np.bool_] = np.diff(recording.samples.time_ns) > PAUSE_S * 1e9
    starts = np.flatnonzero(pauses) + 1
    edges = [0, *starts.tolist(), len(recording)]
    return [recording.rows(slice(start, stop)) for start, stop in pairwise(edges)]

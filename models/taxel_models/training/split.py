"""Which rows are held out: whole trials or chunks of recordings, never single rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from taxel.errors import SettingsError
from taxel_models.recordings import Recording

CHUNK_ROWS: Final = 1000
"""Rows in a chunk, as in the paper."""

_TRIALS_FROM: Final = 20
"""A recording of at least so many segments counts as a series of trials."""

Unit = Literal["auto", "trials", "chunks", "sessions"]


class Subset(IntEnum):
    """What a row is used for."""

    TRAIN = 0
    VALIDATION = 1
    TEST = 2


@dataclass(frozen=True)
class SplitSettings:
    """How to divide recordings.

    Attributes:
        unit: hold out whole `trials` (segments), `chunks` of up to 1000 rows of a segment, or
            `sessions` (recordings); `auto` takes trials where a recording has at least 20 segments.
        test: share of the units held out for testing.
        validation: share of the units held out for early stopping.
        seed: which units; the same seed gives the same ones.
    """

    unit: Unit = "auto"
    test: float = 0.1
    validation: float = 0.1
    seed: int = 0

    def __post_init__(self) -> None:
        if not (0 < self.test < 1 and 0 < self.validation < 1 and self.test + self.validation < 1):
            raise SettingsError(
                f"test {self.test}, validation {self.validation}: expected shares above 0, below 1 in all"
            )

    def describe(self) -> dict[str, Any]:
        """For the trained model's record."""
        return {
            "unit": self.unit,
            "test": self.test,
            "validation": self.validation,
            "seed": self.seed,
            "chunk_rows": CHUNK_ROWS,
        }


def split(recordings: Sequence[Recording], plan: SplitSettings) -> list[NDArray[np.int8]]:
    """The `Subset` of every row of every recording.

    Units are drawn from all recordings together.

    Raises:
        SettingsError: there are too few units for three parts.
    """
    units = units_of(recordings, plan.unit)
    tests = max(1, round(plan.test * len(units)))
    validations = max(1, round(plan.validation * len(units)))
    if tests + validations >= len(units):
        raise SettingsError(
            f"{len(units)} trials or chunks in all: too few for a training, a validation and a test part"
        )
    order = np.random.default_rng(plan.seed).permutation(len(units))
    parts = [np.full(len(recording), Subset.TRAIN, dtype=np.int8) for recording in recordings]
    for place, number in enumerate(order[: tests + validations]):
        index, unit = units[number]
        parts[index][unit] = Subset.TEST if place < tests else Subset.VALIDATION
    return parts


def has_trials(recording: Recording) -> bool:
    """Whether a recording is a series of trials, by its number of segments."""
    return len(recording.segments) >= _TRIALS_FROM


def units_of(recordings: Sequence[Recording], unit: Unit) -> list[tuple[int, slice]]:
    """What is held out whole: the recording's number and the rows of each unit."""
    return [(index, rows) for index, recording in enumerate(recordings) for rows in _units(recording, unit)]


def _units(recording: Recording, unit: Unit) -> list[slice]:
    segments = recording.segments
    if unit == "sessions":
        return [slice(0, len(recording))]
    if unit == "trials" or (unit == "auto" and has_trials(recording)):
        return list(segments)
    return [
        slice(start, min(start + CHUNK_ROWS, segment.stop))
        for segment in segments
        for start in range(segment.start, segment.stop, CHUNK_ROWS)
    ]

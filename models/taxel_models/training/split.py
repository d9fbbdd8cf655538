"""Split recordings into training, validation and test sets by whole groups, never by single rows.

A group is a trial, a chunk or a whole session. Neighbouring rows are much alike, so a split by rows
would test a model on what it was trained on.
"""

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

Grouping = Literal["auto", "trials", "chunks", "sessions"]


class Subset(IntEnum):
    """What a row is used for."""

    TRAIN = 0
    VALIDATION = 1
    TEST = 2


@dataclass(frozen=True)
class SplitSettings:
    """How to divide recordings.

    Attributes:
        grouping: the groups are `trials` (segments), `chunks` of up to 1000 rows of a segment, or
            `sessions` (recordings); `auto` takes trials where a recording has at least 20 segments.
        test: share of the groups held out for testing.
        validation: share of the groups held out for early stopping.
        seed: of the random draw; the same seed draws the same groups.
    """

    grouping: Grouping = "auto"
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
            "unit": self.grouping,
            "test": self.test,
            "validation": self.validation,
            "seed": self.seed,
            "chunk_rows": CHUNK_ROWS,
        }


def split(recordings: Sequence[Recording], settings: SplitSettings) -> list[NDArray[np.int8]]:
    """The `Subset` of every row of every recording.

    Groups are drawn from all recordings together.

    Raises:
        SettingsError: there are too few groups for three sets.
    """
    groups = groups_of(recordings, settings.grouping)
    tests = max(1, round(settings.test * len(groups)))
    validations = max(1, round(settings.validation * len(groups)))
    if tests + validations >= len(groups):
        raise SettingsError(
            f"{len(groups)} trials or chunks in all: too few for a training, a validation and a test set"
        )
    order = np.random.default_rng(settings.seed).permutation(len(groups))
    subsets = [np.full(len(recording), Subset.TRAIN, dtype=np.int8) for recording in recordings]
    for place, number in enumerate(order[: tests + validations]):
        index, rows = groups[number]
        subsets[index][rows] = Subset.TEST if place < tests else Subset.VALIDATION
    return subsets


def subset_of_windows(
    of_row: NDArray[np.int8], rows: NDArray[np.int64], look_back: int, look_ahead: int
) -> NDArray[np.int8]:
    """The subset of each window; -1 if its samples belong to different subsets.

    Args:
        of_row: the `Subset` of every row of a recording.
        rows: (n,) the rows T of the windows.
        look_back: rows before T that a window takes.
        look_ahead: rows after T that a window takes.
    """
    changes = np.concatenate([[0], np.cumsum(np.diff(of_row) != 0)])
    whole = changes[rows - look_back] == changes[rows + look_ahead]
    return np.where(whole, of_row[rows], np.int8(-1))


def has_trials(recording: Recording) -> bool:
    """Whether a recording is a series of trials, by its number of segments."""
    return len(recording.segments) >= _TRIALS_FROM


def groups_of(recordings: Sequence[Recording], grouping: Grouping) -> list[tuple[int, slice]]:
    """What is held out whole: the recording's number and the rows of each group."""
    return [
        (index, rows) for index, recording in enumerate(recordings) for rows in _groups(recording, grouping)
    ]


def _groups(recording: Recording, grouping: Grouping) -> list[slice]:
    segments = recording.segments
    if grouping == "sessions":
        return [slice(0, len(recording))]
    if grouping == "trials" or (grouping == "auto" and has_trials(recording)):
        return list(segments)
    return [
        slice(start, min(start + CHUNK_ROWS, segment.stop))
        for segment in segments
        for start in range(segment.start, segment.stop, CHUNK_ROWS)
    ]

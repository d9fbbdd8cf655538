"""Cross-validation: the windows of each fold's training, validation and test set.

Both protocols leave out windows at the edges between sets, as many as the widest input combination
reaches. So no window of one set uses a row of another, and all combinations are tested on the same rows,
as a paired test requires.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import SettingsError
from taxel.windows import PERIOD_NS, WindowSpec
from taxel.windows.combinations import COMBINATIONS
from taxel_models.recordings import Recording
from taxel_models.study.study_settings import Protocol
from taxel_models.training.split import (
    CHUNK_ROWS,
    Grouping,
    Subset,
    groups_of,
    has_trials,
    subset_of_windows,
)

Numbers = NDArray[np.int64]

VALIDATION_SHARE: Final = 0.1
"""Share of all groups that is taken from the training set for early stopping."""

GUARD: Final = max(
    max(spec.look_back, spec.look_ahead) for spec in (WindowSpec.of(number) for number in COMBINATIONS)
)
"""Windows left out at an edge: the ticks that the widest combination reaches."""


@dataclass(frozen=True)
class Fold:
    """Numbers of windows, counted over all recordings of a `Partition`.

    Attributes:
        statistics: the windows whose mean and standard deviation normalise all windows.
    """

    train: Numbers
    validation: Numbers
    test: Numbers
    statistics: Numbers


@dataclass(frozen=True)
class Partition:
    """A protocol applied to recordings.

    Attributes:
        recordings: resampled to ticks; without gaps if the protocol ignores gaps.
        rows: for each recording, the rows T of the numbered windows.
        held_out: what a test set consists of, in words.
        folds: the windows of each fold.
    """

    recordings: tuple[Recording, ...]
    rows: tuple[Numbers, ...]
    held_out: str
    folds: tuple[Fold, ...]


def choose_grouping(recordings: Sequence[Recording], grouping: Grouping, folds: int) -> Grouping:
    """What `auto` means: sessions if there is one for each fold, else trials, else chunks.

    Raises:
        SettingsError: some recordings are series of trials and others are not.
    """
    if grouping != "auto":
        return grouping
    if len(recordings) >= max(folds, len(Subset)):
        return "sessions"
    trials = [has_trials(recording) for recording in recordings]
    if any(trials) and not all(trials):
        names = [recording.name for recording, found in zip(recordings, trials, strict=True) if found]
        raise SettingsError(
            f"{', '.join(names)} consists of trials, the other recordings do not: choose --unit"
        )
    return "trials" if all(trials) else "chunks"


def partition(
    protocol: Protocol, recordings: Sequence[Recording], grouping: Grouping, folds: int, seed: int
) -> Partition:
    """Divide recordings of ticks into folds.

    Args:
        grouping: what the strict protocol holds out whole; the paper's always holds out chunks.

    Raises:
        SettingsError: there is too little data for so many folds.
    """
    if protocol == "paper":
        return _as_published(recordings, folds, seed)
    return _strict(recordings, grouping, folds, seed)


def _strict(recordings: Sequence[Recording], grouping: Grouping, folds: int, seed: int) -> Partition:
    """Whole groups for testing and for validation; gaps respected; statistics of the training set."""
    groups = groups_of(recordings, grouping)
    validations = max(1, round(VALIDATION_SHARE * len(groups)))
    if len(groups) < folds or len(groups) - -(-len(groups) // folds) <= validations:
        raise SettingsError(f"{len(groups)} {grouping}: too few for {folds} folds of three sets")
    order = np.random.default_rng(seed).permutation(len(groups))
    tests = np.array_split(order, folds)
    found = []
    for number, test in enumerate(tests):
        others = np.setdiff1d(order, test)
        validation = np.random.default_rng([seed, number]).choice(others, validations, replace=False)
        subsets = [np.full(len(recording), Subset.TRAIN, np.int8) for recording in recordings]
        for subset, chosen in ((Subset.TEST, test), (Subset.VALIDATION, validation)):
            for index in chosen:
                recording, rows = groups[index]
                subsets[recording][rows] = subset
        found.append(_strict_fold(recordings, subsets, number))
    rows = tuple(_guarded(recording) for recording in recordings)
    return Partition(tuple(recordings), rows, f"whole {grouping}", tuple(found))


def _guarded(recording: Recording) -> Numbers:
    """Rows as far from the ends of their segments as the widest window reaches."""
    spans = [
        np.arange(segment.start + GUARD, segment.stop - GUARD, dtype=np.int64)
        for segment in recording.segments
    ]
    return np.concatenate([np.empty(0, np.int64), *spans])


def _strict_fold(recordings: Sequence[Recording], subsets: Sequence[NDArray[np.int8]], number: int) -> Fold:
    of_window = []
    for recording, of_row in zip(recordings, subsets, strict=True):
        of_window.append(subset_of_windows(of_row, _guarded(recording), GUARD, GUARD))
    joined = np.concatenate(of_window)
    numbers = {subset: np.flatnonzero(joined == subset) for subset in Subset}
    for subset, found in numbers.items():
        if not len(found):
            raise SettingsError(
                f"fold {number + 1}: the {subset.name.lower()} set has no window of {2 * GUARD + 1} ticks"
            )
    train = numbers[Subset.TRAIN]
    return Fold(train, numbers[Subset.VALIDATION], numbers[Subset.TEST], statistics=train)


def _as_published(recordings: Sequence[Recording], folds: int, seed: int) -> Partition:
    """The published scripts' choices.

    Gaps are ignored. Ticks are divided into chunks of 1000, across trials; the remainder at the end is
    unused. Every chunk loses `GUARD` windows at each edge. All folds test the same number of chunks,
    except the last fold, which tests the remainder. Validation takes stretches of 1000 windows from
    anywhere in the training set. Means and standard deviations are those of all sets together.
    """
    closed = tuple(_without_gaps(recording) for recording in recordings)
    spans = [(len(recording) - 2 * GUARD) // CHUNK_ROWS for recording in closed]
    rows = tuple(np.arange(GUARD, GUARD + max(0, chunks) * CHUNK_ROWS, dtype=np.int64) for chunks in spans)
    chunks = np.arange(sum(map(len, rows)), dtype=np.int64).reshape(-1, CHUNK_ROWS)[:, GUARD:-GUARD]
    each = _chunks_in_fold(len(chunks), folds)
    order = np.random.default_rng(seed).permutation(len(chunks))
    found = []
    for number in range(folds):
        tested = order[number * each :] if number == folds - 1 else order[number * each :][:each]
        fitted = np.setdiff1d(order, tested)
        rng = np.random.default_rng([seed, number])
        train, validation = _published_validation(chunks[fitted].ravel(), each, rng)
        found.append(Fold(train, validation, chunks[np.sort(tested)].ravel(), statistics=chunks.ravel()))
    return Partition(closed, rows, f"chunks of {CHUNK_ROWS} ticks", tuple(found))


def _chunks_in_fold(chunks: int, folds: int) -> int:
    """Test chunks of each fold but the last: rounded up, as 30 of 292, if chunks remain for the last."""
    each = -(-chunks // folds)
    if each * (folds - 1) >= chunks:
        each = chunks // folds
    if not each:
        raise SettingsError(f"{chunks} chunks of {CHUNK_ROWS} ticks: too few for {folds} folds")
    return each


def _published_validation(
    fitted: Numbers, stretches: int, rng: np.random.Generator
) -> tuple[Numbers, Numbers]:
    """Take stretches of 1000 windows, apart from each other and the ends, with guards on both sides."""
    places = len(fitted) - (stretches + 1) * CHUNK_ROWS
    if places < stretches:
        raise SettingsError(
            f"{len(fitted)} windows to fit: too few to take {stretches} stretches of {CHUNK_ROWS} from"
        )
    drawn = np.sort(rng.choice(places, stretches, replace=False))
    starts = drawn + CHUNK_ROWS * np.arange(1, stretches + 1)
    free = np.ones(len(fitted), bool)
    validation = []
    for start in starts:
        free[start - GUARD : start + CHUNK_ROWS + GUARD] = False
        validation.append(fitted[start + GUARD : start + CHUNK_ROWS - GUARD])
    return fitted[free], np.concatenate(validation)


def _without_gaps(recording: Recording) -> Recording:
    """The same rows with times 10 ms apart, so without gaps."""
    time = np.arange(len(recording), dtype=np.int64) * PERIOD_NS
    return replace(recording, samples=replace(recording.samples, time_ns=time, period_ns=PERIOD_NS))

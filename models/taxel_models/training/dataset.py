"""Windows and targets of recordings, divided into sets and ready to fit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.errors import SettingsError
from taxel.trained_contacts import TrainedContacts
from taxel.windows import WindowSpec, build_windows
from taxel_models.recordings import Recording
from taxel_models.recordings.kinds import kinds_of
from taxel_models.training.split import SplitSettings, Subset, split, subset_of_windows

EXTRAS: Final = ("tdc",)
"""Recorded columns that a model may take behind its window: the temperature."""


@dataclass(frozen=True)
class Examples:
    """Windows with the channels measured at their time T.

    Attributes:
        windows: (n, f) float32, m and N.
        channels: (n, 21) float64, counts.
        extras: (n, k) float64, columns as `EXTRAS`, counts.
        auxiliary: (n, 2) float64, `pac1` and `tac`, counts.
    """

    windows: NDArray[np.float32]
    channels: NDArray[np.float64]
    extras: NDArray[np.float64]
    auxiliary: NDArray[np.float64]

    @classmethod
    def at(cls, recording: Recording, windows: NDArray[np.float32], rows: NDArray[np.int64]) -> Self:
        """Windows of a recording of ticks whose T are these rows."""
        measured = recording.auxiliary
        return cls(
            windows,
            recording.channels[rows],
            np.column_stack([measured[name][rows] for name in EXTRAS]),
            np.column_stack([measured["pac1"][rows], measured["tac"][rows]]),
        )

    def __len__(self) -> int:
        return len(self.windows)

    def rows(self, chosen: NDArray[np.int64]) -> Self:
        """The windows of these numbers."""
        return type(self)(*(column[chosen] for column in vars(self).values()))


def examples(recording: Recording, spec: WindowSpec) -> Examples:
    """Every window of a recording with what was measured at its T."""
    ticks = recording.ticks()
    windows = build_windows(ticks.samples, spec)
    return Examples.at(ticks, windows.values, windows.rows)


@dataclass(frozen=True)
class KeptRecordings:
    """What a training keeps of its recordings: of each part, a recording for each source that has any.

    Attributes:
        test: rows that had no part in training at all.
        reference: the same with the validation rows, where the model errs nearly as much.
        fitted: the others, which weights were fitted to.
    """

    test: tuple[Recording, ...]
    reference: tuple[Recording, ...]
    fitted: tuple[Recording, ...]


@dataclass(frozen=True)
class Dataset:
    """Three sets that share no sample.

    Attributes:
        kept: all rows, as recordings.
        contacts: what the training set's contacts range over.
    """

    train: Examples
    validation: Examples
    test: Examples
    kept: KeptRecordings
    contacts: TrainedContacts

    @classmethod
    def of(cls, recordings: Sequence[Recording], spec: WindowSpec, settings: SplitSettings) -> Self:
        """Split recordings and build their windows.

        A window belongs to a set if all its samples do. Windows that reach into two sets are dropped.

        Raises:
            SettingsError: a set would be empty.
        """
        ticks = [recording.ticks() for recording in recordings]
        row_subsets = split(ticks, settings)
        found: dict[Subset, list[Examples]] = {subset: [] for subset in Subset}
        for recording, of_row in zip(ticks, row_subsets, strict=True):
            windows = build_windows(recording.samples, spec)
            of_window = subset_of_windows(of_row, windows.rows, spec.look_back, spec.look_ahead)
            for subset in Subset:
                chosen = of_window == subset
                found[subset].append(Examples.at(recording, windows.values[chosen], windows.rows[chosen]))
        sets = {subset: concatenate(found[subset]) for subset in Subset}
        for subset, content in sets.items():
            if not len(content):
                raise SettingsError(
                    f"the {subset.name.lower()} set has no window: segments are shorter than "
                    f"the {spec.look_back + spec.look_ahead + 1} samples of one, or too few"
                )

        def recordings_of(*subsets: Subset) -> tuple[Recording, ...]:
            rows = [np.isin(of_row, subsets) for of_row in row_subsets]
            return tuple(
                recording.rows(chosen)
                for recording, chosen in zip(ticks, rows, strict=True)
                if chosen.any()
            )

        fitted = recordings_of(Subset.TRAIN)
        return cls(
            sets[Subset.TRAIN],
            sets[Subset.VALIDATION],
            sets[Subset.TEST],
            KeptRecordings(
                test=recordings_of(Subset.TEST),
                reference=recordings_of(Subset.VALIDATION, Subset.TEST),
                fitted=fitted,
            ),
            contacts_of(fitted, max(recording.samples.period_ns for recording in recordings)),
        )

    def counts(self) -> dict[str, int]:
        """Windows in each set."""
        return {"train": len(self.train), "validation": len(self.validation), "test": len(self.test)}


def concatenate(items: list[Examples]) -> Examples:
    """Examples one after another; at least one item, which may be empty."""
    columns = zip(*(vars(item).values() for item in items), strict=True)
    return Examples(*(np.concatenate(column) for column in columns))


def contacts_of(recordings: Sequence[Recording], period_ns: int) -> TrainedContacts:
    """What the contacts of some recordings range over; at least one row. The longest period is told."""
    return TrainedContacts.of(
        np.concatenate([recording.samples.position for recording in recordings]),
        np.concatenate([recording.samples.force for recording in recordings]),
        {name: np.concatenate([recording.auxiliary[name] for recording in recordings]) for name in EXTRAS},
        period_ns / 1e6,
        kinds_of(recordings),
    )

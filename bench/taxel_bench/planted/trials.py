"""Trials of the slide recordings as files: read, changed and written without the project's own reader."""

import csv
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import COUNTS_MAX
from taxel.errors import RecordingError
from taxel_bench.planted.causes import Planting

_CHANNELS: Final = ("pac1", "pdc", *(f"ele{number}" for number in range(1, 20)))


@dataclass(frozen=True, order=True)
class Trial:
    """One trial: four files of a folder `matN`."""

    material: int
    number: int

    def file(self, folder: Path, kind: str) -> Path:
        """One of its files: `bio`, `cp`, `cv` or `cw`."""
        name = f"mat{self.material}"
        return folder / name / f"{name}_{self.number}_{kind}.csv"


def found_in(folder: Path) -> list[Trial]:
    """All trials of a folder.

    Raises:
        RecordingError: there are none.
    """
    found = []
    for path in folder.glob("mat*/*_bio.csv"):
        material, number, _ = path.stem.split("_")
        found.append(Trial(int(material.removeprefix("mat")), int(number)))
    if not found:
        raise RecordingError(f"{folder}: no trials; expected files such as mat1/mat1_1_bio.csv")
    return sorted(found)


def copy(trials: Sequence[Trial], folder: Path, into: Path) -> None:
    """The trials' files as they are."""
    for trial in trials:
        for kind in ("bio", "cp", "cv", "cw"):
            target = trial.file(into, kind)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(trial.file(folder, kind), target)


class Tables:
    """Trials of a folder in the order of time.

    Args:
        trials: some.
        folder: of their files.
    """

    def __init__(self, trials: Sequence[Trial], folder: Path) -> None:
        read = [(trial, *_table(trial.file(folder, "bio"))) for trial in trials]
        read.sort(key=lambda one: one[2][0, 0])
        self._trials = [trial for trial, _, _ in read]
        self._names = read[0][1]
        self._tables = [values for _, _, values in read]
        self._folder = folder
        self._columns = [self._names.index(name) for name in _CHANNELS]
        self._force_n = np.concatenate([self._force_of(trial, values[:, 0]) for trial, _, values in read])

    def planting(self, random: np.random.Generator) -> Planting:
        """To plant causes in."""
        every = np.concatenate(self._tables)
        return Planting(
            counts=every[:, self._columns],
            trial=np.repeat(np.arange(len(self._tables)), [len(values) for values in self._tables]),
            time_s=every[:, 0],
            force_n=self._force_n,
            tdc=every[:, self._names.index("tdc")],
            random=random,
        )

    def _force_of(self, trial: Trial, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        names, wrench = _table(trial.file(self._folder, "cw"))
        columns = [names.index(name) for name in ("fx", "fy", "fz")]
        return np.asarray(np.interp(time_s, wrench[:, 0], np.linalg.norm(wrench[:, columns], axis=1)))

    def write(self, planting: Planting, into: Path) -> None:
        """The trials with planted counts: whole ones from 0 to 4095, as the sensor has."""
        copy(self._trials, self._folder, into)
        for number, (trial, values) in enumerate(zip(self._trials, self._tables, strict=True)):
            changed = values.copy()
            changed[:, self._columns] = np.clip(
                np.rint(planting.counts[planting.trial == number]), 0, COUNTS_MAX
            )
            with trial.file(into, "bio").open("w", encoding="utf-8") as file:
                file.write(",".join(self._names) + "\n")
                for row in changed:
                    file.write(f"{row[0]:.9f}," + ",".join(f"{value:.0f}" for value in row[1:]) + "\n")


def _table(path: Path) -> tuple[list[str], NDArray[np.float64]]:
    with path.open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    names = [name for name in rows[0] if name]
    return names, np.array([[float(value) for value in row[: len(names)]] for row in rows[1:]])

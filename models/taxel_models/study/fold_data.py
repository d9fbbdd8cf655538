"""One fold's windows, z-scored: built once, then fitted by every model."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxel.scaling import Scaler
from taxel.windows import WindowSpec, build_windows
from taxel_models.families.family import FitData
from taxel_models.study.folds import Numbers, Partition
from taxel_models.training.dataset import EXTRAS, Examples, concatenate


@dataclass(frozen=True)
class FoldData:
    """The data of a cell.

    Attributes:
        train: z-scored, as are `validation` and `test`.
        measured: (n, 21) the test set's channels, counts.
        scaler: scaler of the channels.
        tdc: every temperature that occurs in any set, whole counts, ascending, (k,).
        tdc_scaler: scaler of the temperature.
    """

    spec: WindowSpec
    train: FitData
    validation: FitData
    test: FitData
    measured: NDArray[np.float64]
    scaler: Scaler
    tdc: NDArray[np.float64]
    tdc_scaler: Scaler

    @property
    def windows(self) -> dict[str, int]:
        """Windows in each set."""
        return {"train": len(self.train), "validation": len(self.validation), "test": len(self.test)}


def fold_data(partition: Partition, combination: int, fold: int) -> FoldData:
    """Build the windows of a fold (counted from 0) for an input combination."""
    spec = WindowSpec.of(combination)
    table = _all_windows(partition, spec)
    numbers = partition.folds[fold]
    # Column by column, so that only one column at a time exists twice, in float64.
    scalers = {name: Scaler.fit(column[numbers.statistics]) for name, column in vars(table).items()}

    def scaled(chosen: Numbers) -> FitData:
        windows, channels, extras, auxiliary = (
            scalers[name].normalise(column[chosen].astype(np.float32, copy=False))
            for name, column in vars(table).items()
        )
        return FitData(windows, channels, dict(zip(EXTRAS, extras.T, strict=True)), auxiliary)

    return FoldData(
        spec,
        scaled(numbers.train),
        scaled(numbers.validation),
        scaled(numbers.test),
        table.channels[numbers.test],
        scalers["channels"],
        np.unique(np.rint(table.extras[:, EXTRAS.index("tdc")])),
        scalers["extras"],
    )


def _all_windows(partition: Partition, spec: WindowSpec) -> Examples:
    found = []
    for recording, rows in zip(partition.recordings, partition.rows, strict=True):
        windows = build_windows(recording.samples, spec)
        places = np.searchsorted(windows.rows, rows)
        found.append(Examples.at(recording, windows.values[places], rows))
    return concatenate(found)

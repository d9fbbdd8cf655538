"""One fold's windows, z-scored: built once, then fitted by every model."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxel.scaling import Scaler
from taxel.windows import WindowSpec, build_windows
from taxel_models.families.family import FitData
from taxel_models.study.folds import Partition
from taxel_models.training.dataset import EXTRAS, Examples, concatenate
from taxel_models.training.train import Scalers


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
    scalers = Scalers.fit(table.rows(numbers.statistics))
    tdc = table.extras[:, [EXTRAS.index("tdc")]]
    return FoldData(
        spec,
        scalers.apply(table.rows(numbers.train)),
        scalers.apply(table.rows(numbers.validation)),
        scalers.apply(table.rows(numbers.test)),
        table.channels[numbers.test],
        scalers.channels,
        np.unique(np.rint(tdc)),
        Scaler.fit(tdc[numbers.statistics]),
    )


def _all_windows(partition: Partition, spec: WindowSpec) -> Examples:
    found = []
    for recording, rows in zip(partition.recordings, partition.rows, strict=True):
        windows = build_windows(recording.samples, spec)
        places = np.searchsorted(windows.rows, rows)
        found.append(Examples.at(recording, windows.values[places], rows))
    return concatenate(found)

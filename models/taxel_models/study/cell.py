"""One cell: fit a model to a fold and compute its errors on the test set."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from taxel import __version__
from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.families.family import FitTask, History, Progress, unseen
from taxel_models.families.registry import family
from taxel_models.study.fold_data import FoldData
from taxel_models.study.study_settings import Cell, Protocol
from taxel_models.study.sweep import TemperatureSweep, sweep_temperature
from taxel_models.training.dataset import EXTRAS

Metric = Literal["mae", "norm_mae", "rmse", "norm_rmse"]

OfChannels = Annotated[tuple[FiniteFloat, ...], Field(min_length=len(CHANNELS), max_length=len(CHANNELS))]


class ChannelErrors(BaseModel):
    """Errors of the 21 channels on a test set.

    Attributes:
        mae: mean absolute error, counts.
        norm_mae: the same in standard deviations of the channel.
        rmse: root of the mean square error, counts.
        norm_rmse: the same in standard deviations of the channel.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    mae: OfChannels
    norm_mae: OfChannels
    rmse: OfChannels
    norm_rmse: OfChannels

    @classmethod
    def of(
        cls, measured: NDArray[np.float64], predicted: NDArray[np.float32], std: NDArray[np.float32]
    ) -> Self:
        """Compare (n, 21) counts; `std` (21,) are the standard deviations that normalise."""
        absolute = ErrorMetrics.of(measured, predicted, std)
        rmse = np.sqrt(np.square(measured - predicted).mean(axis=0))
        return cls(
            mae=tuple(absolute.channel_mae.tolist()),
            norm_mae=tuple(absolute.channel_norm_mae.tolist()),
            rmse=tuple(rmse.tolist()),
            norm_rmse=tuple((rmse / std.astype(np.float64)).tolist()),
        )

    def mean(self, metric: Metric, *, electrodes: bool = False) -> float:
        """Over all channels, or over the electrodes."""
        values: tuple[float, ...] = getattr(self, metric)
        return float(np.mean(values[ELECTRODE_COLUMNS] if electrodes else values))


class CellResult(BaseModel):
    """What is kept of a finished cell.

    Attributes:
        key: see `StudySettings.key`; the hash of everything that the result depends on.
        fold: counted from 0.
        parameters: learnable ones; for trees their nodes.
        windows: in each set.
        test: errors of the model; one that takes the temperature is given its mean.
        test_measured_temperature: its errors with the temperature as measured.
        sweep: its errors with each temperature that occurs, if the settings ask for it.
        mean_predictor: errors of the mean predictor.
        seconds: duration of fitting and testing, on `jobs` cores.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Literal[1] = 1
    key: str
    protocol: Protocol
    model: str
    combination: int
    fold: int
    hyperparameters: dict[str, Any]
    parameters: int
    windows: dict[str, int]
    test: ChannelErrors
    test_measured_temperature: ChannelErrors | None
    sweep: TemperatureSweep | None = None
    mean_predictor: ChannelErrors
    history: History
    seconds: float
    jobs: int
    taxel_version: str


@dataclass(frozen=True)
class CellTask:
    """A cell to compute.

    Attributes:
        jobs: cores to use.
        sweep: test a model that takes the temperature with each that occurs.
        checkpoint: where a network keeps its progress; its folder may be missing on another machine.
    """

    cell: Cell
    key: str
    hyperparameters: dict[str, Any]
    seed: int
    jobs: int
    sweep: bool
    checkpoint: Path


def compute(data: FoldData, task: CellTask, progress: Progress = unseen) -> CellResult:
    """Fit and test."""
    started = time.monotonic()
    kind = family(task.cell.model)
    fit = FitTask(
        spec=data.spec,
        train=data.train,
        validation=data.validation,
        seed=task.seed + task.cell.fold,
        jobs=task.jobs,
        progress=progress,
        extras=EXTRAS,
        checkpoint=task.checkpoint if task.checkpoint.parent.is_dir() else None,
    )
    fitted, history = kind.fit(fit, kind.hyperparameters.model_validate(task.hyperparameters))

    def errors(z_scores: NDArray[np.float32]) -> ChannelErrors:
        return ChannelErrors.of(data.measured, data.scaler.restore(z_scores), data.scaler.std)

    measured_temperature = None
    if fitted.extras:
        measured_temperature = errors(fitted.predict(data.test.windows, data.test.extras))
    return CellResult(
        key=task.key,
        protocol=task.cell.protocol,
        model=task.cell.model,
        combination=task.cell.combination,
        fold=task.cell.fold,
        hyperparameters=task.hyperparameters,
        parameters=fitted.parameters,
        windows=data.windows,
        test=errors(fitted.predict(data.test.windows)),
        test_measured_temperature=measured_temperature,
        sweep=sweep_temperature(data, fitted) if task.sweep else None,
        mean_predictor=errors(np.zeros(data.measured.shape, np.float32)),
        history=history,
        seconds=time.monotonic() - started,
        jobs=task.jobs,
        taxel_version=__version__,
    )

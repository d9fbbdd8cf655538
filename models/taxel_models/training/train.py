"""Training: recordings in, a trained model and its held-out recordings out."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray

from taxel import __version__
from taxel.channels import CHANNELS
from taxel.errors import SettingsError
from taxel.manifest import Normalisation, Source, Training
from taxel.scaling import Scaler
from taxel.windows import WindowSpec
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.families.family import FitData, FitTask, FittedModel, Progress, unseen
from taxel_models.families.registry import family, resolve
from taxel_models.recordings import Recording
from taxel_models.training.dataset import Dataset, Examples
from taxel_models.training.split import SplitSettings
from taxel_models.training.trained import Temperature, TrainedModel, TrainedRecord

TemperatureUse = Literal["measured", "mean", "none"]

TEMPERATURE_USES: Final[tuple[TemperatureUse, ...]] = ("measured", "mean", "none")


@dataclass(frozen=True)
class TrainingSettings:
    """What to train.

    Attributes:
        model: the family's name.
        combination: input combination 1..8.
        overrides: hyperparameters that replace the paper's.
        temperature: for families that take one: `measured` trains with it, tests with it and
            serves it as a named input; `mean` trains with it, then fixes it at its mean, as
            the paper's baseline; `none` leaves it out.
        jobs: cores to use.
        checkpoint: where to keep the progress of a long training.
    """

    model: str
    combination: int
    split: SplitSettings = field(default_factory=SplitSettings)
    seed: int = 0
    overrides: dict[str, Any] = field(default_factory=dict)
    temperature: TemperatureUse = "mean"
    jobs: int = 1
    checkpoint: Path | None = None


@dataclass(frozen=True)
class Scalers:
    """Statistics of a training set, for each of its columns."""

    windows: Scaler
    channels: Scaler
    temperature: Scaler
    auxiliary: Scaler

    @classmethod
    def fit(cls, examples: Examples) -> Self:
        """From the training set."""
        return cls(*(Scaler.fit(column) for column in vars(examples).values()))

    def apply(self, examples: Examples) -> FitData:
        """Any examples as z-scores."""
        windows, channels, temperature, auxiliary = (
            scaler.normalise(column.astype(np.float32, copy=False))
            for scaler, column in zip(vars(self).values(), vars(examples).values(), strict=True)
        )
        return FitData(windows, channels, temperature[:, 0], auxiliary)


def train(
    recordings: Sequence[Recording], settings: TrainingSettings, progress: Progress = unseen
) -> tuple[TrainedModel, tuple[Recording, ...]]:
    """Fit a model and evaluate it on the test set.

    Inputs and outputs are z-scored with statistics of the training set alone.

    Returns:
        The model and the test rows as recordings.

    Raises:
        SettingsError: the settings are not possible with these recordings.
    """
    if settings.temperature not in TEMPERATURE_USES:
        raise SettingsError(f"temperature {settings.temperature!r}: expected {', '.join(TEMPERATURE_USES)}")
    kind = family(settings.model)
    hyperparameters = resolve(kind, settings.combination, settings.overrides)
    spec = WindowSpec.of(settings.combination)
    data = Dataset.of(recordings, spec, settings.split)
    scalers = Scalers.fit(data.train)
    task = FitTask(
        spec=spec,
        train=scalers.apply(data.train),
        validation=scalers.apply(data.validation),
        seed=settings.seed,
        jobs=settings.jobs,
        progress=progress,
        with_temperature=settings.temperature != "none",
        checkpoint=settings.checkpoint,
    )
    fitted, history = kind.fit(task, hyperparameters)
    temperature = None
    if fitted.takes_temperature:
        temperature = Temperature(
            served=settings.temperature == "measured",
            mean=float(scalers.temperature.mean[0]),
            std=float(scalers.temperature.std[0]),
        )
    record = TrainedRecord(
        combination=settings.combination,
        parameters=fitted.parameters,
        normalisation=_normalisation(scalers),
        temperature=temperature,
        training=Training(
            family=kind.name,
            data=tuple(_source(recording) for recording in recordings),
            windows=data.counts(),
            split=settings.split.describe(),
            seed=settings.seed,
            hyperparameters=hyperparameters.model_dump(mode="json"),
            metrics=_metrics(data.test, fitted, scalers, temperature),
        ),
        history=history,
        taxel_version=__version__,
    )
    return TrainedModel(record, fitted), data.test_recordings


def _normalisation(scalers: Scalers) -> Normalisation:
    return Normalisation(
        input_mean=tuple(scalers.windows.mean.tolist()),
        input_std=tuple(scalers.windows.std.tolist()),
        output_mean=tuple(scalers.channels.mean.tolist()),
        output_std=tuple(scalers.channels.std.tolist()),
    )


def _source(recording: Recording) -> Source:
    return Source(
        name=recording.name, format=recording.format, rows=len(recording), sha256=recording.fingerprint
    )


def _metrics(
    test: Examples, fitted: FittedModel, scalers: Scalers, temperature: Temperature | None
) -> dict[str, Any]:
    """Errors on the test set: those of the model as it will be served, and those of the mean predictor.

    For a model that takes the temperature, also the errors with the measured and the mean temperature.
    """
    scaled = scalers.apply(test)

    def errors(measured_temperature: bool) -> dict[str, Any]:
        z_scores = fitted.predict(scaled.windows, scaled.temperature if measured_temperature else None)
        predicted = scalers.channels.restore(z_scores)
        return ErrorMetrics.of(test.channels, predicted, scalers.channels.std).report()

    mean: NDArray[np.float32] = np.broadcast_to(scalers.channels.mean, (len(test), len(CHANNELS)))
    found = {
        "test": errors(temperature is not None and temperature.served),
        "mean_predictor": ErrorMetrics.of(test.channels, mean, scalers.channels.std).report(),
    }
    if temperature is not None:
        found["test_measured_temperature"] = errors(True)
        found["test_mean_temperature"] = errors(False)
    return found

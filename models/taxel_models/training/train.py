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
from taxel.manifest import Normalisation, RecordingFingerprint, Training
from taxel.scaling import Scaler
from taxel.windows import WindowSpec
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.families.family import NO_EXTRAS, FitData, FitTask, FittedModel, Progress, unseen
from taxel_models.families.registry import family, resolve
from taxel_models.recordings import Recording
from taxel_models.training.dataset import EXTRAS, Dataset, Examples, KeptRecordings
from taxel_models.training.split import SplitSettings
from taxel_models.training.trained import TrainedExtra, TrainedModel, TrainedRecord

ExtrasUse = Literal["measured", "mean", "none"]

EXTRAS_USES: Final[tuple[ExtrasUse, ...]] = ("measured", "mean", "none")


@dataclass(frozen=True)
class TrainingSettings:
    """What to train.

    Attributes:
        model: the family's name.
        combination: input combination 1..8.
        overrides: hyperparameters that replace the paper's.
        extras: for families that take extra inputs, such as the temperature: `measured` trains
            with them, tests with them and serves them as named inputs; `mean` trains with them,
            then fixes each at its mean, as the paper's baseline; `none` leaves them out.
        jobs: cores to use.
        checkpoint: where to keep the progress of a long training.
    """

    model: str
    combination: int
    split: SplitSettings = field(default_factory=SplitSettings)
    seed: int = 0
    overrides: dict[str, Any] = field(default_factory=dict)
    extras: ExtrasUse = "mean"
    jobs: int = 1
    checkpoint: Path | None = None


@dataclass(frozen=True)
class Scalers:
    """Statistics of a training set, for each of its columns."""

    windows: Scaler
    channels: Scaler
    extras: Scaler
    auxiliary: Scaler

    @classmethod
    def fit(cls, examples: Examples) -> Self:
        """From the training set."""
        return cls(*(Scaler.fit(column) for column in vars(examples).values()))

    def apply(self, examples: Examples) -> FitData:
        """Any examples as z-scores."""
        windows, channels, extras, auxiliary = (
            scaler.normalise(column.astype(np.float32, copy=False))
            for scaler, column in zip(vars(self).values(), vars(examples).values(), strict=True)
        )
        return FitData(windows, channels, dict(zip(EXTRAS, extras.T, strict=True)), auxiliary)


def train(
    recordings: Sequence[Recording], settings: TrainingSettings, progress: Progress = unseen
) -> tuple[TrainedModel, KeptRecordings]:
    """Fit a model and evaluate it on the test set.

    Inputs and outputs are z-scored with statistics of the training set alone.

    Returns:
        The model and the rows that it was fitted to, and those that it was not.

    Raises:
        SettingsError: the settings are not possible with these recordings.
    """
    if settings.extras not in EXTRAS_USES:
        raise SettingsError(f"extras {settings.extras!r}: expected {', '.join(EXTRAS_USES)}")
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
        extras=() if settings.extras == "none" else EXTRAS,
        checkpoint=settings.checkpoint,
    )
    fitted, history = kind.fit(task, hyperparameters)
    extras = tuple(
        TrainedExtra(
            name=name,
            served=settings.extras == "measured",
            mean=float(scalers.extras.mean[EXTRAS.index(name)]),
            std=float(scalers.extras.std[EXTRAS.index(name)]),
        )
        for name in fitted.extras
    )
    record = TrainedRecord(
        combination=settings.combination,
        parameters=fitted.parameters,
        normalisation=_normalisation(scalers),
        extras=extras,
        training=Training(
            family=kind.name,
            data=tuple(_fingerprint_of(recording) for recording in recordings),
            windows=data.counts(),
            split=settings.split.describe(),
            seed=settings.seed,
            hyperparameters=hyperparameters.model_dump(mode="json"),
            metrics=_metrics(data.test, fitted, scalers, settings.extras),
            contacts=data.contacts,
        ),
        history=history,
        taxel_version=__version__,
    )
    return TrainedModel(record, fitted), data.kept


def _normalisation(scalers: Scalers) -> Normalisation:
    return Normalisation(
        input_mean=tuple(scalers.windows.mean.tolist()),
        input_std=tuple(scalers.windows.std.tolist()),
        output_mean=tuple(scalers.channels.mean.tolist()),
        output_std=tuple(scalers.channels.std.tolist()),
    )


def _fingerprint_of(recording: Recording) -> RecordingFingerprint:
    return RecordingFingerprint(
        name=recording.name, format=recording.format, rows=len(recording), sha256=recording.fingerprint
    )


def _metrics(test: Examples, fitted: FittedModel, scalers: Scalers, use: ExtrasUse) -> dict[str, Any]:
    """Errors on the test set: those of the model as it will be served, and those of the mean predictor.

    For a model that takes the temperature, also the errors with the measured and the mean temperature.
    """
    scaled = scalers.apply(test)

    def errors(measured_extras: bool) -> dict[str, Any]:
        z_scores = fitted.predict(scaled.windows, scaled.extras if measured_extras else NO_EXTRAS)
        predicted = scalers.channels.restore(z_scores)
        return ErrorMetrics.of(test.channels, predicted, scalers.channels.std).report()

    mean: NDArray[np.float32] = np.broadcast_to(scalers.channels.mean, (len(test), len(CHANNELS)))
    found = {
        "test": errors(use == "measured"),
        "mean_predictor": ErrorMetrics.of(test.channels, mean, scalers.channels.std).report(),
    }
    if fitted.extras:
        found["test_measured_temperature"] = errors(True)
        found["test_mean_temperature"] = errors(False)
    return found

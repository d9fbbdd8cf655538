"""Training: recordings in, a trained model and its held-out recordings out."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxel import __version__
from taxel.channels import CHANNELS
from taxel.manifest import Normalisation, Source, Training
from taxel.scaling import Scaler
from taxel.windows import WindowSpec
from taxel_models.evaluation.metrics import Errors
from taxel_models.families.family import FitPart, FitTask, Progress, unseen
from taxel_models.families.registry import family, resolve
from taxel_models.recordings import Recording
from taxel_models.training.dataset import Dataset, Examples
from taxel_models.training.split import SplitPlan
from taxel_models.training.trained import TrainedModel, TrainedRecord


@dataclass(frozen=True)
class TrainingPlan:
    """What to train.

    Attributes:
        model: the family's name.
        combination: input combination 1..8.
        overrides: hyperparameters that replace the paper's.
        jobs: cores to use; the result does not depend on it.
    """

    model: str
    combination: int
    split: SplitPlan = field(default_factory=SplitPlan)
    seed: int = 0
    overrides: dict[str, Any] = field(default_factory=dict)
    jobs: int = 1


def train(
    recordings: Sequence[Recording], plan: TrainingPlan, progress: Progress = unseen
) -> tuple[TrainedModel, tuple[Recording, ...]]:
    """Fit a model and evaluate it on the test part.

    Inputs and outputs are z-scored with statistics of the training part alone.

    Returns:
        The model and the test rows as recordings.

    Raises:
        SettingsError: the plan is not possible with these recordings.
    """
    kind = family(plan.model)
    hyperparameters = resolve(kind, plan.combination, plan.overrides)
    spec = WindowSpec.of(plan.combination)
    data = Dataset.of(recordings, spec, plan.split)
    inputs, outputs = Scaler.fit(data.train.windows), Scaler.fit(data.train.channels)
    task = FitTask(
        train=_scaled(data.train, inputs, outputs),
        validation=_scaled(data.validation, inputs, outputs),
        seed=plan.seed,
        jobs=plan.jobs,
        progress=progress,
    )
    fitted = kind.fit(task, hyperparameters)
    predicted = outputs.restore(fitted.predict(inputs.normalise(data.test.windows)))
    record = TrainedRecord(
        combination=plan.combination,
        parameters=fitted.parameters,
        normalisation=_normalisation(inputs, outputs),
        training=Training(
            family=kind.name,
            data=tuple(_source(recording) for recording in recordings),
            windows=data.counts(),
            split=plan.split.describe(),
            seed=plan.seed,
            hyperparameters=hyperparameters.model_dump(mode="json"),
            metrics=_metrics(data, predicted, outputs),
        ),
        history=fitted.history(),
        taxel_version=__version__,
    )
    return TrainedModel(record, fitted), data.test_recordings


def _scaled(part: Examples, inputs: Scaler, outputs: Scaler) -> FitPart:
    return FitPart(inputs.normalise(part.windows), outputs.normalise(part.channels.astype(np.float32)))


def _normalisation(inputs: Scaler, outputs: Scaler) -> Normalisation:
    return Normalisation(
        input_mean=tuple(inputs.mean.tolist()),
        input_std=tuple(inputs.std.tolist()),
        output_mean=tuple(outputs.mean.tolist()),
        output_std=tuple(outputs.std.tolist()),
    )


def _source(recording: Recording) -> Source:
    return Source(
        name=recording.name, format=recording.format, rows=len(recording), sha256=recording.fingerprint
    )


def _metrics(data: Dataset, predicted: NDArray[np.float32], outputs: Scaler) -> dict[str, Any]:
    """Errors on the test part: the model's, and those of always saying the training mean."""
    measured = data.test.channels
    mean = np.broadcast_to(outputs.mean, (len(measured), len(CHANNELS)))
    return {
        "test": Errors.of(measured, predicted, outputs.std).report(),
        "mean_predictor": Errors.of(measured, mean, outputs.std).report(),
    }

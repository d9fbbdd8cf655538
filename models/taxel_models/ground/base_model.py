"""The base model of a real ground: a small XGBoost model that is trained within seconds."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel import __version__
from taxel.channels import CHANNELS
from taxel.manifest import Manifest, ModelFile, tensors
from taxel_models.families.xgb import XgbModel
from taxel_models.ground.ground import Floats, predicted
from taxel_models.recordings import Recording
from taxel_models.training.split import SplitSettings
from taxel_models.training.train import TrainingSettings, train
from taxel_models.training.trained import TrainedModel

COMBINATION: Final = 1

SMALL: Final[Mapping[str, Any]] = {
    "n_estimators": 60,
    "max_depth": 7,
    "eta": 0.15,
    "min_child_weight": 20,
    "max_bin": 128,
}
"""Hyperparameters in place of the paper's: about a tenth of its trees."""


@dataclass(frozen=True)
class BaseModel:
    """A trained model that the loop can take without an export.

    Trees that were fitted to the absolute error predict medians. They are shifted to means, so that what
    is left of a clean recording has none.

    Attributes:
        shift: (21,) mean of measured less predicted, counts.
        reference: what training held out.
        fitted: what it did not.
    """

    trained: TrainedModel
    shift: Floats
    reference: Recording
    fitted: Recording

    @classmethod
    def fit(cls, recording: Recording, seed: int, jobs: int) -> Self:
        """Train on most of the segments of a recording."""
        settings = TrainingSettings(
            "xgb",
            COMBINATION,
            SplitSettings("trials", seed=seed),
            seed=seed,
            overrides=dict(SMALL),
            jobs=jobs,
        )
        trained, kept = train([recording], settings)
        # The loop asks for few rows, some hundred times.
        trained = replace(trained, fitted=_as_trees(trained).as_one_booster())
        (reference,), (fitted,) = kept.reference, kept.fitted
        unshifted = cls(trained, np.zeros(len(CHANNELS)), reference, fitted)
        # A mean needs many rows, and trees are as skewed on those that they were fitted to.
        errors = [unshifted.errors(part) for part in (reference, fitted)]
        return replace(unshifted, shift=np.concatenate(errors).mean(axis=0))

    def errors(self, recording: Recording) -> Floats:
        """(m, 21) measured less predicted at the ticks that have a whole window, counts."""
        counts, rows = predicted(self, recording)
        return np.asarray(recording.channels[rows] - counts)

    @cached_property
    def manifest(self) -> Manifest:
        """As the model's artifact would have it."""
        record, layout = self.trained.record, self.trained.layout
        inputs, outputs = tensors(layout)
        weights = b"".join(bytes(booster.save_raw()) for booster in _as_trees(self.trained).boosters)
        return Manifest(
            name="base",
            version="1",
            description="The base model of a ground.",
            platform="xgboost_json",
            inputs=inputs,
            outputs=outputs,
            window=layout,
            normalisation=self.trained.served_normalisation,
            parameters=record.parameters,
            training=record.training,
            model_file=ModelFile(
                name="model.json", sha256=hashlib.sha256(weights).hexdigest(), size=len(weights)
            ),
            taxel_version=__version__,
        )

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 21) counts of windows (n, f)."""
        return self.trained.predict(windows) + self.shift.astype(np.float32)

    def predict_base(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The same as `predict`: the model has no effects."""
        return self.predict(windows)


def _as_trees(trained: TrainedModel) -> XgbModel:
    if not isinstance(trained.fitted, XgbModel):
        raise TypeError(f"{type(trained.fitted).__name__}: expected XgbModel")
    return trained.fitted

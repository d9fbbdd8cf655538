"""A trained model on disk: what training writes and exporting reads.

DIR/trained.json      family, inputs, hyperparameters, normalisation, split, metrics, losses
DIR/loss.png          the loss after each step of fitting
DIR/weights/          the family's own files
DIR/held_out/*.csv    the test rows of each recording, to evaluate any model on
DIR/reference/*.csv   these and the validation rows: what the loop judges the model's own errors by
DIR/fitted/*.csv      the other rows, for the same: small trees that did not see a contact predict it
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from taxel.artifacts import describe
from taxel.atomic import whole_folder
from taxel.errors import ArtifactError, InvalidArgument
from taxel.manifest import Normalisation, Training, WindowLayout
from taxel.scaling import Scaler
from taxel.windows import ExtraFeature, WindowSpec
from taxel_models.families.family import NO_EXTRAS, FittedModel, History
from taxel_models.families.registry import family
from taxel_models.recordings import Recording, read_ruppel, write_ruppel
from taxel_models.training.curve import draw_history
from taxel_models.training.dataset import KeptRecordings

RECORD: Final = "trained.json"
HELD_OUT: Final = "held_out"
REFERENCE: Final = "reference"
FITTED: Final = "fitted"
CURVE: Final = "loss.png"


class TrainedExtra(BaseModel):
    """An extra input that the model was fitted with, such as the temperature `tdc`.

    Attributes:
        served: it is a named input of the served model; otherwise fixed at its mean.
        mean: in the training set, counts.
        std: standard deviation in the training set, counts.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    served: bool
    mean: FiniteFloat
    std: Annotated[float, Field(gt=0)]


class TrainedRecord(BaseModel):
    """The content of `trained.json`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Literal[1] = 1
    combination: Annotated[int, Field(ge=1, le=8)]
    parameters: int
    normalisation: Normalisation
    extras: tuple[TrainedExtra, ...] = ()
    training: Training
    history: History
    taxel_version: str

    @model_validator(mode="before")
    @classmethod
    def _with_extras(cls, fields: Any) -> Any:
        """Taxel 0.1 kept the temperature alone, apart from other extras."""
        if not isinstance(fields, Mapping) or "temperature" not in fields:
            return fields
        temperature = fields["temperature"]
        others = {name: value for name, value in fields.items() if name != "temperature"}
        return {**others, "extras": [] if temperature is None else [{"name": "tdc", **temperature}]}


@dataclass(frozen=True)
class TrainedModel:
    """A fitted model, with the record of its training."""

    record: TrainedRecord
    fitted: FittedModel

    @property
    def spec(self) -> WindowSpec:
        """The window that it takes."""
        return WindowSpec.of(self.record.combination)

    @property
    def served_extras(self) -> tuple[TrainedExtra, ...]:
        """The extras that are inputs of the served model."""
        return tuple(extra for extra in self.record.extras if extra.served)

    @property
    def layout(self) -> WindowLayout:
        """What the served model takes: the window, and the extras that are served."""
        extras = (
            ExtraFeature(name=extra.name, unit="counts", default=extra.mean) for extra in self.served_extras
        )
        return WindowLayout.of(self.spec, tuple(extras))

    @property
    def served_normalisation(self) -> Normalisation:
        """The statistics of everything that the served model takes, columns as `layout`."""
        normalisation, extras = self.record.normalisation, self.served_extras
        means = (*normalisation.input_mean, *(extra.mean for extra in extras))
        stds = (*normalisation.input_std, *(extra.std for extra in extras))
        return normalisation.model_copy(update={"input_mean": means, "input_std": stds})

    def predict(
        self, windows: NDArray[np.float32], extras: Mapping[str, NDArray[np.float32]] = NO_EXTRAS
    ) -> NDArray[np.float32]:
        """Predict with the library that the model was trained with.

        Args:
            windows: (n, f), m and N.
            extras: (n,) each, counts, by name; the mean stands in for one that is not given.

        Returns:
            (n, 21), counts.

        Raises:
            InvalidArgument: the model takes no extra of a given name.
        """
        known = [extra.name for extra in self.record.extras]
        unknown = [name for name in extras if name not in known]
        if unknown:
            raise InvalidArgument(f"extras {unknown}: expected {known or 'none'}")
        normalisation = self.record.normalisation
        inputs = Scaler.of(normalisation.input_mean, normalisation.input_std)
        outputs = Scaler.of(normalisation.output_mean, normalisation.output_std)
        z_scores = {
            extra.name: Scaler.of([extra.mean], [extra.std]).normalise(extras[extra.name])
            for extra in self.record.extras
            if extra.name in extras
        }
        return outputs.restore(self.fitted.predict(inputs.normalise(windows), z_scores))


def save(model: TrainedModel, kept: KeptRecordings, folder: Path, *, overwrite: bool = False) -> None:
    """Write a trained model and the recordings that it keeps; the folder appears whole or not at all.

    Raises:
        SettingsError: the folder exists and may not be overwritten, or is not a trained model.
    """
    with whole_folder(folder, replacing=RECORD, overwrite=overwrite) as place:
        (place / "weights").mkdir()
        model.fitted.save(place / "weights")
        parts = {HELD_OUT: kept.test, REFERENCE: kept.reference, FITTED: kept.fitted}
        for name, recordings in parts.items():
            (place / name).mkdir()
            for number, recording in enumerate(recordings, start=1):
                write_ruppel(recording, place / name / f"{number}_{Path(recording.name).stem}.csv")
        draw_history(model.record.history, place / CURVE)
        record = json.dumps(model.record.model_dump(mode="json"), indent=1) + "\n"
        (place / RECORD).write_text(record, encoding="utf-8")


def load(folder: Path) -> TrainedModel:
    """Read a trained model.

    Raises:
        ArtifactError: the folder is not a trained model, or its content is damaged.
    """
    path = folder / RECORD
    try:
        record = TrainedRecord.model_validate_json(path.read_bytes())
    except OSError as error:
        raise ArtifactError(f"{path}: {error.strerror}; expected what `taxel train` wrote") from None
    except ValidationError as error:
        raise ArtifactError(f"{path}: {describe(error)}") from None
    return TrainedModel(record, family(record.training.family).load(folder / "weights"))


def held_out(folder: Path) -> list[Recording]:
    """The test rows that were kept with a trained model.

    Raises:
        ArtifactError: there are none.
    """
    paths = sorted((folder / HELD_OUT).glob("*.csv"))
    if not paths:
        raise ArtifactError(f"{folder / HELD_OUT}: no recording; expected the held-out rows")
    return [read_ruppel(path) for path in paths]


def reference(folder: Path) -> list[Recording]:
    """All rows that no weight was fitted to; the test rows alone where an earlier version trained.

    Raises:
        ArtifactError: there are none.
    """
    paths = sorted((folder / REFERENCE).glob("*.csv"))
    return [read_ruppel(path) for path in paths] or held_out(folder)


def fitted(folder: Path) -> list[Recording]:
    """The rows that weights were fitted to; none where an earlier version trained."""
    return [read_ruppel(path) for path in sorted((folder / FITTED).glob("*.csv"))]

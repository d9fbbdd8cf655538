"""A trained model on disk: what training writes and exporting reads.

DIR/trained.json      family, inputs, hyperparameters, normalisation, split, metrics, losses
DIR/loss.png          the loss after each step of fitting
DIR/weights/          the family's own files
DIR/held_out/*.csv    the test rows of each recording, to evaluate any model on
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from taxel.artifacts import describe
from taxel.atomic import whole_folder
from taxel.errors import ArtifactError
from taxel.manifest import Normalisation, Training, WindowLayout
from taxel.scaling import Scaler
from taxel.windows import ExtraFeature, WindowSpec
from taxel_models.families.family import FittedModel, History
from taxel_models.families.registry import family
from taxel_models.recordings import Recording, read_ruppel, write_ruppel
from taxel_models.training.curve import draw_history

RECORD: Final = "trained.json"
CURVE: Final = "loss.png"


class Temperature(BaseModel):
    """How a model that takes the temperature gets it.

    Attributes:
        served: it is a named input of the served model; otherwise fixed at its mean.
        mean: mean of `tdc` in the training set, counts.
        std: standard deviation of `tdc` in the training set, counts.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

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
    temperature: Temperature | None = None
    training: Training
    history: History
    taxel_version: str


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
    def serves_temperature(self) -> bool:
        """Whether the temperature is an input of the served model."""
        return self.record.temperature is not None and self.record.temperature.served

    @property
    def layout(self) -> WindowLayout:
        """What the served model takes: the window, and the temperature if it is served."""
        extras: tuple[ExtraFeature, ...] = ()
        if self.serves_temperature and self.record.temperature is not None:
            extras = (ExtraFeature(name="tdc", unit="counts", default=self.record.temperature.mean),)
        return WindowLayout.of(self.spec, extras)

    @property
    def served_normalisation(self) -> Normalisation:
        """The statistics of everything that the served model takes, columns as `layout`."""
        normalisation, temperature = self.record.normalisation, self.record.temperature
        if temperature is None or not temperature.served:
            return normalisation
        means = (*normalisation.input_mean, temperature.mean)
        stds = (*normalisation.input_std, temperature.std)
        return normalisation.model_copy(update={"input_mean": means, "input_std": stds})

    def predict(
        self, windows: NDArray[np.float32], temperature: NDArray[np.float32] | None = None
    ) -> NDArray[np.float32]:
        """Predict with the library that the model was trained with.

        Args:
            windows: (n, f), m and N.
            temperature: (n,) `tdc` in counts, for a model that takes it; its mean if not given.

        Returns:
            (n, 21), counts.
        """
        normalisation = self.record.normalisation
        inputs = Scaler.of(normalisation.input_mean, normalisation.input_std)
        outputs = Scaler.of(normalisation.output_mean, normalisation.output_std)
        z_scores = None
        if temperature is not None and self.record.temperature is not None:
            scaler = Scaler.of([self.record.temperature.mean], [self.record.temperature.std])
            z_scores = scaler.normalise(temperature)
        return outputs.restore(self.fitted.predict(inputs.normalise(windows), z_scores))


def save(
    model: TrainedModel, held_out: tuple[Recording, ...], folder: Path, *, overwrite: bool = False
) -> None:
    """Write a trained model and its held-out recordings; the folder appears whole or not at all.

    Raises:
        SettingsError: the folder exists and may not be overwritten, or is not a trained model.
    """
    with whole_folder(folder, replacing=RECORD if overwrite else None) as place:
        (place / "weights").mkdir()
        model.fitted.save(place / "weights")
        (place / "held_out").mkdir()
        for number, recording in enumerate(held_out, start=1):
            write_ruppel(recording, place / "held_out" / f"{number}_{Path(recording.name).stem}.csv")
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
    paths = sorted((folder / "held_out").glob("*.csv"))
    if not paths:
        raise ArtifactError(f"{folder / 'held_out'}: no recording; expected the held-out rows")
    return [read_ruppel(path) for path in paths]

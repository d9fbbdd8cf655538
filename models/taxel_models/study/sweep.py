"""The errors of a model that takes the temperature, if it is given a fixed temperature."""

from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.families.family import FittedModel
from taxel_models.study.fold_data import FoldData

_Curve = Annotated[tuple[FiniteFloat, ...], Field(min_length=1)]


class TemperatureSweep(BaseModel):
    """Errors on one test set, by the given temperature.

    Attributes:
        mean_tdc: the mean that the model was fitted around, counts.
        tdc: every whole count that occurs in the data, ascending, (k,).
        mae: over all channels, counts, (k,).
        norm_mae: the same in standard deviations of each channel, (k,).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    mean_tdc: FiniteFloat
    tdc: _Curve
    mae: _Curve
    norm_mae: _Curve

    @model_validator(mode="after")
    def _one_error_a_temperature(self) -> Self:
        if not len(self.tdc) == len(self.mae) == len(self.norm_mae):
            raise ValueError("tdc, mae and norm_mae: expected as many values each")
        return self


def sweep_temperature(data: FoldData, fitted: FittedModel) -> TemperatureSweep:
    """Test a model that takes the temperature with each temperature that occurs."""
    temperatures = data.tdc_scaler.normalise(data.tdc.astype(np.float32)[:, None])[:, 0]
    errors = [
        ErrorMetrics.of(
            data.measured, data.scaler.restore(_predict_at(data, fitted, temperature)), data.scaler.std
        )
        for temperature in temperatures
    ]
    return TemperatureSweep(
        mean_tdc=float(data.tdc_scaler.mean[0]),
        tdc=tuple(data.tdc.tolist()),
        mae=tuple(error.mae for error in errors),
        norm_mae=tuple(error.norm_mae for error in errors),
    )


def _predict_at(data: FoldData, fitted: FittedModel, temperature: np.float32) -> NDArray[np.float32]:
    return fitted.predict(data.test.windows, {"tdc": np.full(len(data.test), temperature, np.float32)})

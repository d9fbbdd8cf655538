"""A weighted sum of features: offsets, gains, drift, temperature, creep, hysteresis, rate, covariates."""

from functools import cached_property
from typing import Annotated, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, model_validator
from typing_extensions import override

from taxel.channels import CHANNELS, COUNTS_MAX, ELECTRODE_COLUMNS
from taxel.corrections.term import BaseTerm, Columns
from taxel.schema import PerChannel

ONE: Final = "one"
"""The feature that is always 1, for an offset or a gain; its reference is 0."""

Shape = Literal["unit", "signal", "log_impedance"]


class Weighted(BaseTerm):
    """`delta_c = shape_c(p) Σ_k weights[k][c] (phi_k - references[k])`.

    Attributes:
        shape: how the effect acts on a channel: `unit` is 1, counts are added; `signal` is
            p_c - rest_c, a gain; `log_impedance` is the slope of an electrode's counts in the
            logarithm of its impedance, dE/d ln Z = -p_c (1 - p_c/4095), which follows from the
            sensor's converter, Z = (4095/E - 1) 10 kΩ. `pac0` and `pdc` measure no impedance: 1.
        features: phi, names of window features or extras, or `one`.
        references: where each feature has no effect, in its unit.
        weights: per feature, one number a channel.
        rest: resting value of each channel, counts; needed by `signal`.
    """

    kind: Literal["weighted"] = "weighted"
    shape: Shape
    features: Annotated[tuple[str, ...], Field(min_length=1)]
    references: tuple[FiniteFloat, ...]
    weights: tuple[PerChannel, ...]
    rest: PerChannel | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        for field, values in (("references", self.references), ("weights", self.weights)):
            if len(values) != len(self.features):
                raise ValueError(f"{field} has {len(values)} values: expected {len(self.features)}")
        for feature, reference in zip(self.features, self.references, strict=True):
            if feature == ONE and reference:
                raise ValueError(f"reference of {ONE!r} is {reference}: expected 0")
        if self.shape == "signal" and self.rest is None:
            raise ValueError("shape 'signal': expected the channels' rest")
        return self

    @cached_property
    @override
    def takes(self) -> tuple[str, ...]:
        return tuple(feature for feature in self.features if feature != ONE)

    @override
    def delta(self, p: NDArray[np.float64], columns: Columns) -> NDArray[np.float64]:
        weights, constant = self._linear
        amount = constant
        if self.takes:
            amount = np.array([columns[name] for name in self.takes]).T @ weights + constant
        return weighted_shape(self.shape, p, self._rest) * amount

    @cached_property
    def _linear(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Weights of the features that vary, (k, 21), and what `one` and the references come to, (21,)."""
        weights, references = np.array(self.weights), np.array(self.references)
        varies = np.array([feature != ONE for feature in self.features])
        constant = weights[~varies].sum(axis=0) - references[varies] @ weights[varies]
        return weights[varies], constant

    @cached_property
    def _rest(self) -> NDArray[np.float64]:
        return np.array(self.rest or (0.0,) * len(CHANNELS))


def weighted_shape(shape: Shape, p: NDArray[np.float64], rest: NDArray[np.float64]) -> NDArray[np.float64]:
    """How strongly an effect acts on each channel; see `Weighted.shape`.

    Args:
        p: (n, 21), the base model's prediction, counts.
        rest: (21,), resting value of each channel, counts; used by `signal`.

    Returns:
        (n, 21): 1, p - rest in counts, or the slope dE/d ln Z in counts.
    """
    if shape == "signal":
        return p - rest
    slope = np.ones_like(p)
    if shape == "log_impedance":
        electrodes = p[:, ELECTRODE_COLUMNS]
        slope[:, ELECTRODE_COLUMNS] = -electrodes * (1 - electrodes / COUNTS_MAX)
    return slope

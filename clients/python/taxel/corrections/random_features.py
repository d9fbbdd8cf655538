"""Random features: a smooth function of the prediction and of features, without a formula behind it."""

from functools import cached_property
from typing import Annotated, Final, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, model_validator
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections.term import BaseTerm, Columns
from taxel.schema import PerChannel, Positive

PREDICTED: Final = len(CHANNELS)
"""The first inputs are the base model's own channels."""


class _Arrays(NamedTuple):
    means: NDArray[np.float64]
    scales: NDArray[np.float64]
    projection: NDArray[np.float64]
    phases: NDArray[np.float64]
    weights: NDArray[np.float64]
    constants: NDArray[np.float64]


class RandomFeatures(BaseTerm):
    """`delta_c = constants[c] + Σ_j weights[j][c] cos(phases[j] + Σ_i projection[i][j] z_i)`.

    z_i = clip((u_i - means[i]) / scales[i], ±limit); u are the 21 predicted channels, then the features.
    Such cosines of a random projection stand for a smooth kernel (Rahimi and Recht 2007). z is clipped, so
    that the term stays as it is at the border of what was recorded.

    Attributes:
        features: names of window features or extras.
        means: of each input.
        scales: of each input.
        limit: of z.
        projection: for each input, one number a cosine.
        phases: one for each cosine.
        weights: for each cosine, one number a channel, counts.
        constants: counts.
    """

    kind: Literal["random_features"] = "random_features"
    features: tuple[str, ...]
    means: tuple[FiniteFloat, ...]
    scales: tuple[Positive, ...]
    limit: Positive
    projection: tuple[tuple[FiniteFloat, ...], ...]
    phases: Annotated[tuple[FiniteFloat, ...], Field(min_length=1)]
    weights: tuple[PerChannel, ...]
    constants: PerChannel

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        inputs, cosines = PREDICTED + len(self.features), len(self.phases)
        lengths = {
            "means": (len(self.means), inputs),
            "scales": (len(self.scales), inputs),
            "projection": (len(self.projection), inputs),
            "weights": (len(self.weights), cosines),
        }
        for field, (found, expected) in lengths.items():
            if found != expected:
                raise ValueError(f"{field} has {found} values: expected {expected}")
        for row, values in enumerate(self.projection):
            if len(values) != cosines:
                raise ValueError(f"projection[{row}] has {len(values)} values: expected {cosines}")
        return self

    @property
    @override
    def takes(self) -> tuple[str, ...]:
        return self.features

    @override
    def delta(self, p: NDArray[np.float64], columns: Columns) -> NDArray[np.float64]:
        arrays = self._arrays
        inputs = np.empty((len(p), len(arrays.means)))
        inputs[:, :PREDICTED] = p
        for place, name in enumerate(self.features, start=PREDICTED):
            inputs[:, place] = columns[name]
        z = np.clip((inputs - arrays.means) / arrays.scales, -self.limit, self.limit)
        return np.asarray(np.cos(z @ arrays.projection + arrays.phases) @ arrays.weights + arrays.constants)

    @cached_property
    def _arrays(self) -> _Arrays:
        return _Arrays(*(np.array(getattr(self, name)) for name in _Arrays._fields))

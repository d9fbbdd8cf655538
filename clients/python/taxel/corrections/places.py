"""An error that depends on where the contact is: a smooth map over the skin."""

from functools import cached_property
from typing import Annotated, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from typing_extensions import override

from taxel.corrections.term import BaseTerm, Columns
from taxel.schema import PerChannel, Positive, Vector

_POSITION: Final = ("x", "y", "z")
_FORCE: Final = ("fx", "fy", "fz")


class Places(BaseTerm):
    """delta_c = g Σ_k weights[k][c] exp(-|pos - centres[k]|² / (2 width²)), g = |F| / (|F| + half_force).

    Without a contact there is no place, so g is 0 at no force.

    Attributes:
        centres: of the Gaussians, m.
        width: of each, m.
        half_force: at which g is a half, N.
        weights: per centre, counts a channel.
    """

    kind: Literal["places"] = "places"
    centres: Annotated[tuple[Vector, ...], Field(min_length=1)]
    width: Positive
    half_force: Positive
    weights: tuple[PerChannel, ...]

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if len(self.weights) != len(self.centres):
            raise ValueError(f"weights has {len(self.weights)} rows: expected {len(self.centres)}")
        return self

    @property
    @override
    def takes(self) -> tuple[str, ...]:
        return (*_POSITION, *_FORCE)

    @override
    def delta(self, p: NDArray[np.float64], columns: Columns) -> NDArray[np.float64]:
        force = np.sqrt(sum(columns[name] ** 2 for name in _FORCE))
        squared = sum(
            (columns[name][:, None] - self._centres[:, axis]) ** 2 for axis, name in enumerate(_POSITION)
        )
        bumps = np.exp(squared / (-2 * self.width**2))
        load = force / (force + self.half_force)
        return load[:, None] * (bumps @ self._weights)

    @cached_property
    def _centres(self) -> NDArray[np.float64]:
        return np.array(self.centres)

    @cached_property
    def _weights(self) -> NDArray[np.float64]:
        return np.array(self.weights)

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


class Location(BaseTerm):
    """`delta_c = g Σ_k weights[k][c] exp(-|pos - centres[k]|² / (2 width²)), g = |F| / (|F| + half_force)`.

    Without a contact there is no place, so g is 0 at no force.

    Attributes:
        centres: of the Gaussians, m.
        width: of each, m.
        half_force: at which g is a half, N.
        weights: per centre, counts a channel.
    """

    kind: Literal["location"] = "location"
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
        position = np.array([columns[name] for name in _POSITION]).T
        force = np.sqrt(sum(columns[name] ** 2 for name in _FORCE))
        design = location_design(position, force, self._centres, self.width, self.half_force)
        return design @ self._weights

    @cached_property
    def _centres(self) -> NDArray[np.float64]:
        return np.array(self.centres)

    @cached_property
    def _weights(self) -> NDArray[np.float64]:
        return np.array(self.weights)


def location_design(
    position: NDArray[np.float64],
    force: NDArray[np.float64],
    centres: NDArray[np.float64],
    width: float,
    half_force: float,
) -> NDArray[np.float64]:
    """The Gaussians that the weights of a `Location` multiply.

    Args:
        position: (n, 3), m.
        force: (n,), the force's magnitude, N.
        centres: (k, 3), m.
        width: of each Gaussian, m.
        half_force: at which the force's factor is a half, N.

    Returns:
        (n, k), without unit: |F| / (|F| + half_force) exp(-|pos - centre|² / (2 width²)).
    """
    squared = sum((position[:, axis, None] - centres[:, axis]) ** 2 for axis in range(3))
    load = force / (force + half_force)
    return np.asarray(load[:, None] * np.exp(squared / (-2 * width**2)))

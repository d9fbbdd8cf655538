"""How deep the indenter sinks, and how much of its force the fluid carries.

The contact law is Hertz's for a sphere, and it stiffens without limit as the skin meets the core:
F = F_c u^1.5 / (1 - u^2), where u is the indentation over its local limit, the stroke. The fluid
carries the Hertzian part, F_c u^1.5; the core carries what remains. So the pressure is about linear in a
small force and bends near 2 N. Where there is more fluid, the same force sinks deeper.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.skin import gap_to_skin
from taxel_models.twin.sensor import Sensor

RUBBER_MM: Final = 0.9
"""Thickness of the skin itself, taken as incompressible. Assumption."""

FLUID_LIMIT_N: Final = 1.7
"""F_c, the most that the fluid can carry. Fitted: puts the pressure's knee near 2 N (SynTouch manual)."""

_TABLE_U: Final = np.linspace(0.0, 0.98, 4097)
_TABLE_LOAD: Final = _TABLE_U**1.5 / (1.0 - _TABLE_U**2)

STROKE: Final = 1.2
"""Deepest indentation over the fluid's thickness: the rubber gives a little more. Fitted to LASA."""

_NEARBY_MM: Final = 1.5
"""The distance over which the fluid's thickness is interpolated between electrodes. Assumption."""


@dataclass(frozen=True)
class Skin:
    """The skin over the electrodes of one untouched sensor.

    Attributes:
        feet: (19, 3), the skin's points above the electrodes, mm.
        fluid: (19,), thickness of the fluid over the electrodes, mm.
    """

    feet: NDArray[np.float64]
    fluid: NDArray[np.float64]

    @classmethod
    def of(cls, sensor: Sensor) -> "Skin":
        """From the sensor's geometry alone. There is more fluid over the flat facet under the round tip."""
        gap = gap_to_skin(sensor.positions, sensor.normals, sensor.skin_radius)
        return cls(sensor.positions + gap[:, None] * sensor.normals, gap - RUBBER_MM)

    def squared_distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """From points (n, 3) to the feet: (n, 19), mm²."""
        cross = points @ self.feet.T
        squares = np.einsum("ij,ij->i", points, points)[:, None] + np.einsum(
            "ij,ij->i", self.feet, self.feet
        )
        return np.asarray(np.maximum(squares - 2.0 * cross, 0.0))

    def fluid_near(self, squared_distances: NDArray[np.float64]) -> NDArray[np.float64]:
        """Thickness of the fluid at places (n,), mm, interpolated between the electrodes."""
        nearest = squared_distances.min(axis=1, keepdims=True)
        weights = np.exp(-(squared_distances - nearest) / (2.0 * _NEARBY_MM**2))
        return np.asarray(weights @ self.fluid / weights.sum(axis=1))


def sunk_share(force: NDArray[np.float64]) -> NDArray[np.float64]:
    """Indentation u over the stroke, 0 to 1, under normal forces (n,) N."""
    return np.interp(np.maximum(force, 0.0) / FLUID_LIMIT_N, _TABLE_LOAD, _TABLE_U)


def dent(sunk: NDArray[np.float64], indented: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth of the dent in the skin's inner side, mm (n,), if the outer dent is `indented` mm deep.

    The rubber takes up most of a light touch and little of a strong one: the share that reaches the
    fluid is u. This is an assumption; without it, light touches make the fluid too thin.
    """
    return np.asarray(sunk * indented)


def fluid_force(force: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part of normal forces (n,) N that the fluid carries, N."""
    return np.asarray(FLUID_LIMIT_N * sunk_share(force) ** 1.5)

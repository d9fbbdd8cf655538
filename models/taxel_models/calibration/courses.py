"""The second fit of the placement, from all positions of the contacts instead of one position of each.

A tracker's error changes little during one contact. So the positions of a contact show the direction of the
skin well, although each position is uncertain. The model of a position's signed distance from the skin is

    distance = standoff - (s + d) F^(2/3) + n · o + e

F^(2/3) is Hertz's indentation under a force F, with a softness s that all contacts share and each
contact's own deviation d from it. o is the contact's error, the same at all its positions, n the skin's
normal there, and e the position's own error. o, d and e are random, each with its own standard
deviation. The placement, the standoff and s are those that make the distances most likely
(generalised least squares).

n rotates as a contact moves over the round skin. So the model is linear about the current estimate of the
positions without their errors, and it is solved again until nothing changes.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import RecordingError
from taxel.skin import height_above_skin
from taxel_models.calibration.identifiability import residual_sd
from taxel_models.calibration.light_contacts import LightContacts
from taxel_models.calibration.motion import Placement, outward

SOFTNESS_SD_MM: Final = 1.0
"""SD of the deviations d, and of s about 0. It is wide: an indentation under 1 N is about a millimetre."""

OUTLIER: Final = 2.0
"""Contacts with errors of more than so many SDs count about linearly."""

_POSITION_MM: Final = 0.1
"""Initial SD of a position's own error."""

_ROUNDS: Final = 200
_SETTLED_MM: Final = 1e-4
"""The most rounds, and the change of a component, mm or rad, below which the fit has converged."""


@dataclass(frozen=True)
class Refined:
    """The placement from whole courses.

    Attributes:
        placement: as refined.
        softness: s, the indentation under 1 N, mm.
        contact_error: SD of a contact's error in each axis, mm.
        position_error: SD of a position's own error, mm.
        heights: (n,), distances of the light touches from the skin, less standoff and indentation, mm.
        resampled: (draws, k), the components of bootstrap resamples.
    """

    placement: Placement
    softness: float
    contact_error: float
    position_error: float
    heights: NDArray[np.float64]
    resampled: NDArray[np.float64]


@dataclass(frozen=True)
class _Round:
    """The model, linear about some placement and errors.

    Attributes:
        normal: (n, c, c), each contact's share of the normal matrix, for c columns.
        right: (n, c), each contact's share of the right-hand side.
        errors: (n, 3), each contact's error as estimated, mm.
        own: (m,), the remaining error of each position, mm.
        fitted: the effective number of fitted parameters.
    """

    normal: NDArray[np.float64]
    right: NDArray[np.float64]
    errors: NDArray[np.float64]
    own: NDArray[np.float64]
    fitted: float


def refine(
    contacts: LightContacts,
    radius: float,
    placement: Placement,
    free: NDArray[np.bool_],
    pull: NDArray[np.float64],
    draws: NDArray[np.int64],
) -> Refined:
    """Refine a placement that brings the light touches onto a skin of `radius` mm.

    Args:
        free: (k,), which components to refine.
        pull: (free components,), strength of the weak pull towards the recorded frame, per mm or rad.
        draws: (draws, n), contacts of the bootstrap resamples.

    Raises:
        RecordingError: the fit does not converge.
    """
    courses = _Courses(contacts, radius, free, placement.centre)
    heights = height_above_skin(placement.placed(contacts.position, contacts.orientation), radius)
    contact_error = residual_sd(heights - placement.standoff, float(free.sum()))
    values = np.append(placement.values, 0.0)
    chosen = np.append(free, True)
    weak = np.append(pull, 1.0 / SOFTNESS_SD_MM) ** 2
    position_error = min(_POSITION_MM, contact_error)
    errors = change = np.zeros((len(contacts), 3))
    share = np.ones((len(contacts), 1))
    for _ in range(_ROUNDS):
        linear = courses.linear(values, errors, contact_error, position_error)
        weights = 1.0 / np.sqrt(1.0 + (linear.errors**2).sum(axis=1) / (OUTLIER * contact_error) ** 2)
        normal, right = weights[:, None, None] * linear.normal, weights[:, None] * linear.right
        step = _solved(normal.sum(axis=0), right.sum(axis=0), values[chosen], weak)
        if np.abs(step).max() < _SETTLED_MM:
            break
        values[chosen] += step
        change, before = linear.errors - errors, change
        # Near the seam of the skin, two linear models may lead to each other without end.
        share[(change * before).sum(axis=1) < 0.0] *= 0.5
        errors = errors + share * change
        position_error = residual_sd(linear.own, linear.fitted)
    else:
        raise RecordingError(
            f"the courses of the {len(contacts)} contacts settle on no placement: after {_ROUNDS} rounds "
            f"it still moves by {np.abs(step).max():.2g} mm; expected contacts with one skin"
        )
    resampled = np.tile(values[:-1], (len(draws), 1))
    for row, drawn in zip(resampled, draws, strict=True):
        times = np.bincount(drawn, minlength=len(contacts)).astype(float)
        step = _solved(np.tensordot(times, normal, 1), times @ right, values[chosen], weak)
        row[free] += step[:-1]
    return Refined(
        placement=Placement(values[:-1], placement.centre),
        softness=float(values[-1]),
        contact_error=contact_error,
        position_error=position_error,
        heights=courses.heights(values)[contacts.ends],
        resampled=resampled,
    )


def _solved(
    normal: NDArray[np.float64],
    right: NDArray[np.float64],
    values: NDArray[np.float64],
    weak: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The step (c,) from `values`, with the weak pull of each component towards 0."""
    return np.asarray(np.linalg.solve(normal + np.diag(weak), right - weak * values))


class _Courses:
    """The courses of contacts on a skin, as a function of the components."""

    def __init__(
        self, contacts: LightContacts, radius: float, free: NDArray[np.bool_], centre: NDArray[np.float64]
    ) -> None:
        self._contacts, self._radius, self._free, self._centre = contacts, radius, free, centre
        self._indented = contacts.force ** (2.0 / 3.0)
        lengths = np.diff(np.append(contacts.starts, len(contacts.course)))
        self._contact = np.repeat(np.arange(len(contacts)), lengths)

    def heights(
        self, values: NDArray[np.float64], errors: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Distances (m,) from the skin, less standoff and indentation, mm.

        Args:
            values: (k + 1,), the components and the softness.
            errors: (n, 3), the contacts' errors, which are subtracted; none if not given.
        """
        placement = Placement(values[:-1], self._centre)
        placed = placement.placed(self._contacts.course, self._contacts.course_orientation)
        if errors is not None:
            placed = placed - errors[self._contact]
        above = height_above_skin(placed, self._radius)
        return np.asarray(above - placement.standoff + values[-1] * self._indented)

    def linear(
        self,
        values: NDArray[np.float64],
        errors: NDArray[np.float64],
        contact_error: float,
        position_error: float,
    ) -> _Round:
        """The model about `values` (k + 1,) and the contacts' errors (n, 3).

        With the random effects' columns B, in units of their SDs, a contact's distances have the
        covariance C = B Bᵀ + τ² I. Its inverse is (I - B (τ² I + BᵀB)⁻¹ Bᵀ) / τ².
        """
        placement = Placement(values[:-1], self._centre)
        points, orientation = self._contacts.course, self._contacts.course_orientation
        outwards = outward(placement.placed(points, orientation) - errors[self._contact])
        shifts = np.einsum("ij,ij->i", outwards, errors[self._contact])
        distances = self.heights(values, errors) + shifts
        derivatives = placement.height_derivatives(points, orientation, outwards)[:, self._free]
        columns = np.column_stack([derivatives, self._indented, distances])
        effects = np.column_stack([contact_error * outwards, SOFTNESS_SD_MM * self._indented])
        squares = self._sums(effects[:, :, None] * effects[:, None, :])
        inner = squares + position_error**2 * np.eye(effects.shape[1])
        random = np.linalg.solve(inner, self._sums(effects[:, :, None] * columns[:, None, :]))
        left = columns - np.einsum("ij,ijk->ik", effects, random[self._contact])
        products = self._sums(columns[:, :, None] * left[:, None, :]) / position_error**2
        return _Round(
            normal=products[:, :-1, :-1],
            right=-products[:, :-1, -1],
            errors=np.asarray(contact_error * random[:, :3, -1]),
            own=left[:, -1],
            fitted=float(np.trace(np.linalg.solve(inner, squares), axis1=1, axis2=2).sum()),
        )

    def _sums(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sums over each contact's rows (m, …): (n, …)."""
        return np.add.reduceat(rows, self._contacts.starts, axis=0)

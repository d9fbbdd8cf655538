"""The placement that brings contacts onto the skin.

Robust least squares on the light touches finds it from several starts, and shows which components they
determine. A second fit to all positions of the contacts refines it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from taxel.errors import RecordingError, SettingsError
from taxel.skin import height_above_skin
from taxel_models.calibration.courses import refine
from taxel_models.calibration.identifiability import undetermined
from taxel_models.calibration.light_contacts import LightContacts
from taxel_models.calibration.motion import RIGID, STANDOFF, Placement, components_of, outward

OUTLIER_MM: Final = 1.0
"""Larger distances count about linearly (soft L1 loss), so an outlier has little weight."""

STARTS: Final = 16
"""Random starts, in addition to the recorded frame."""

RESAMPLES: Final = 120
"""Bootstrap resamples, from which the intervals come."""

ALIKE: Final = 1.05
"""Costs within 5 % of the least count as equal: the difference is noise."""

EXTENT_MM: Final = 2.0
"""Contacts closer to their centre than this (root mean square) do not determine a frame."""

_TYPICAL: Final = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 1.0, 1.0, 1.0])
"""Steps of about equal effect, mm and rad."""

_FAR: Final = {"tilt_y": 10.0, "tilt_z": 10.0, "standoff": 5.0}
_FAR_MM: Final = 1e3
"""Scales of a weak pull towards the recorded frame and a small standoff. The pull only decides between
placements that fit equally well. Without it, a line of contacts would get a skin with a radius near 0."""

_EVALUATIONS: Final = 100
"""The most steps of one start. A problem that is well determined needs about ten."""

_SOMEWHERE_MM: Final = (-4.0, 0.0, -3.0)
"""About where the centre of contacts with a fingertip lies: starts scatter around it."""


@dataclass(frozen=True)
class Fit:
    """The best placement and how well it is known.

    Attributes:
        names: the components, k of them.
        placement: held components are 0, given ones as given.
        held: components that the contacts do not determine.
        given: components that were known beforehand.
        resampled: (draws, k), the components of bootstrap resamples; constant for components not fitted.
        agreeing: starts that ended at the light touches' placement, of `STARTS` + 1.
        softness: indentation under 1 N, mm.
        contact_error: SD of the error that a contact's positions share, in each axis, mm.
        position_error: SD of each position's own error, mm.
        before: (n,), signed distance of the light touches as recorded from the skin, mm.
        after: (n,), the same once placed, less the standoff and the indentation.
    """

    names: tuple[str, ...]
    placement: Placement
    held: tuple[str, ...]
    given: tuple[str, ...]
    resampled: NDArray[np.float64]
    agreeing: int
    softness: float
    contact_error: float
    position_error: float
    before: NDArray[np.float64]
    after: NDArray[np.float64]


class _Problem:
    """Residuals of light touches as a function of the components that are free.

    Args:
        known: (k,), values of the components; NaN for those that are free.
    """

    def __init__(
        self,
        contacts: LightContacts,
        centre: NDArray[np.float64],
        radius: float,
        known: NDArray[np.float64],
    ) -> None:
        far = [_FAR.get(name, _FAR_MM) for name in components_of(contacts)]
        self._position, self._orientation = contacts.position, contacts.orientation
        self._centre, self._radius, self._known = centre, radius, known
        self._free = np.isnan(known)
        self.pulls = 1.0 / np.array(far)[self._free]

    def full(self, chosen: NDArray[np.float64]) -> NDArray[np.float64]:
        """All components (k,), from those that are free."""
        values = self._known.copy()
        values[self._free] = chosen
        return values

    def heights(self, chosen: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signed distance of the touches from the skin, less the standoff, mm (n,)."""
        placement = Placement(self.full(chosen), self._centre)
        placed = placement.placed(self._position, self._orientation)
        return height_above_skin(placed, self._radius) - placement.standoff

    def pull(self, chosen: NDArray[np.float64]) -> float:
        """How far from the recorded frame, in units of `_FAR`."""
        return float(np.linalg.norm(self.pulls * chosen))

    def _residuals(self, chosen: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([self.heights(chosen), self.pulls * chosen])

    def _jacobian(self, chosen: NDArray[np.float64]) -> NDArray[np.float64]:
        placement = Placement(self.full(chosen), self._centre)
        normal = outward(placement.placed(self._position, self._orientation))
        heights = placement.height_derivatives(self._position, self._orientation, normal)
        return np.vstack([heights[:, self._free], np.diag(self.pulls)])

    def solve(self, start: NDArray[np.float64]) -> Any:
        """scipy's result from a start (free components,)."""
        return least_squares(
            self._residuals,
            start,
            self._jacobian,
            max_nfev=_EVALUATIONS,
            x_scale=_TYPICAL[: len(self._free)][self._free],
            loss="soft_l1",
            f_scale=OUTLIER_MM,
        )


def fit(contacts: LightContacts, radius: float, seed: int, standoff: float | None = None) -> Fit:
    """Place contacts on a skin of `radius` mm.

    Components that the contacts do not determine are held at 0, one after another, and the others are
    fitted again.

    Args:
        seed: seed of the starts and of the resamples.
        standoff: distance of the tracked point from the skin at first touch, mm, if it is known.

    Raises:
        RecordingError: all contacts are in one place, they determine nothing, or the fit does not converge.
        SettingsError: a standoff is given where an offset is fitted.
    """
    count = len(contacts)
    centre = contacts.position.mean(axis=0)
    lever = float(np.sqrt(((contacts.position - centre) ** 2).sum(axis=1).mean()))
    if lever < EXTENT_MM:
        raise RecordingError(
            f"the {count} light contacts lie within {lever:.2f} mm (rms) of one place, which does not "
            f"determine a frame; expected contacts spread over the skin, by at least {EXTENT_MM:g} mm"
        )
    names = components_of(contacts)
    known = _known(names, standoff)
    starting, resampling = np.random.default_rng(seed).spawn(2)
    starts = _starts(centre, np.isnan(known), starting)
    best, agreeing = _best(_Problem(contacts, centre, radius, known), starts)
    held: list[str] = []
    while (loose := undetermined(best.jac[:count], best.fun[:count], known, lever)) is not None:
        if np.isnan(known).sum() == 1:
            raise RecordingError(
                f"the {count} light contacts determine nothing: they are off any skin by "
                f"{np.abs(best.fun[:count]).mean():.2f} mm in the mean"
            )
        keep = np.flatnonzero(np.isnan(known)) != loose
        known[loose] = 0.0
        held.append(names[loose])
        best = _Problem(contacts, centre, radius, known).solve(best.x[keep])
    problem = _Problem(contacts, centre, radius, known)
    draws = resampling.integers(0, count, (RESAMPLES, count))
    placement = Placement(problem.full(best.x), centre)
    refined = refine(contacts, radius, placement, np.isnan(known), problem.pulls, draws)
    return Fit(
        names=names,
        placement=refined.placement,
        held=tuple(held),
        given=STANDOFF if standoff is not None else (),
        resampled=refined.resampled,
        agreeing=agreeing,
        softness=refined.softness,
        contact_error=refined.contact_error,
        position_error=refined.position_error,
        before=height_above_skin(contacts.position, radius),
        after=refined.heights,
    )


def _known(names: tuple[str, ...], standoff: float | None) -> NDArray[np.float64]:
    known = np.full(len(names), np.nan)
    if standoff is not None:
        if names != RIGID + STANDOFF:
            raise SettingsError(
                f"standoff {standoff:g} mm: the recordings have the probe's orientation, with which its "
                "offset is fitted; expected no standoff"
            )
        known[-1] = standoff
    return known


def _starts(
    centre: NDArray[np.float64], free: NDArray[np.bool_], dice: np.random.Generator
) -> list[NDArray[np.float64]]:
    """The recorded frame itself, then axes in every direction with the centre near the skin's."""
    starts = [np.zeros(len(free))]
    for _ in range(STARTS):
        around, angle = dice.uniform(0.0, 2.0 * np.pi), np.arccos(dice.uniform(-1.0, 1.0))
        start = np.zeros(len(free))
        start[:3] = np.asarray(_SOMEWHERE_MM) + dice.normal(0.0, 4.0, 3) - centre
        start[3:5] = angle * np.cos(around), angle * np.sin(around)
        starts.append(start)
    return [start[free] for start in starts]


def _best(problem: _Problem, starts: Sequence[NDArray[np.float64]]) -> tuple[Any, int]:
    """The best placement that is nearest to the recorded frame, and how many starts reached it."""
    results = [problem.solve(start) for start in starts]
    least = min(result.cost for result in results)
    alike = [result for result in results if result.cost <= ALIKE * least + 1e-9]
    best = min(alike, key=lambda result: problem.pull(result.x))
    return best, int(sum(np.allclose(result.x, best.x, atol=0.01) for result in alike))

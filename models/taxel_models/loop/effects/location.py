"""Location: the error depends on where the contact is."""

from collections.abc import Iterable
from functools import partial
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.corrections import Location as LocationTerm
from taxel.corrections import location_design
from taxel.windows.history import TOUCH_N
from taxel_models.loop.basis import Floats, Shared
from taxel_models.loop.effects.effect import Candidate, Effect, Online, Remaining
from taxel_models.loop.observations import Observations

CENTRES: Final = 16
HALF_FORCE_N: Final = 0.5
WIDTH: Final = 0.8
"""The width of a bump over the mean distance between neighbouring centres: bumps overlap smoothly."""

SKIN_M: Final = 0.04
"""The skin of a fingertip is not wider: 15 mm across and 25 mm along."""

LEAST_SD_M: Final = 2e-4
_CANDIDATES: Final = 2000


class Location(Effect):
    """Smooth bumps over the touched places. They grow with the force."""

    name = "location"
    equation = "delta_c = |F|/(|F| + 0.5 N) sum_k w_ck exp(-|x - x_k|² / (2 s²))"
    source = "radial basis functions; the force's factor is 0 in free air and flattens as the skin does"
    signature = "the residual repeats wherever the same place is pressed, whenever that is"

    @override
    def out_of_scope(self, observations: Observations) -> str | None:
        touched = observations.position[observations.pressed > TOUCH_N]
        if not len(touched):
            return None
        low, high = np.quantile(touched, (0.02, 0.98), axis=0)
        span = float(np.linalg.norm(high - low))
        if span <= SKIN_M:
            return None
        return f"positions span {span * 1e3:.0f} mm: poses of a robot, not places on a skin"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        position, pressed = _served(observations)
        touched = position[remaining.fit & (pressed > TOUCH_N)]
        if len(touched) < CENTRES or touched.std(axis=0).max() < LEAST_SD_M:
            return
        centres = farthest_points(touched, CENTRES)
        distances = np.linalg.norm(centres[:, None] - centres[None], axis=2)
        spacing = float(np.partition(distances, 1, axis=1)[:, 1].mean())
        yield self._with(centres, WIDTH * max(spacing, LEAST_SD_M), observations)

    def _with(self, centres: Floats, width: float, observations: Observations) -> Candidate:
        def online(weights: Floats) -> Online:
            term = LocationTerm(
                centres=tuple(tuple(centre) for centre in centres.tolist()),
                width=width,
                half_force=HALF_FORCE_N,
                weights=tuple(tuple(row) for row in weights.T.tolist()),
            )
            return Online((term,))

        return Candidate(
            self.name,
            f"{len(centres)} bumps",
            Shared(location_design(*_served(observations), centres, width, HALF_FORCE_N)),
            weight_names=tuple(f"bump {number}" for number in range(1, len(centres) + 1)),
            weight_units=("counts",),
            form_parameters={"width": (width * 1e3, "mm")},
            online=online,
            again=partial(self._with, centres, width),
        )


def _served(observations: Observations) -> tuple[Floats, Floats]:
    """(n, 3) positions and (n,) forces' magnitudes of a served window, before a lag is corrected."""
    rows = observations.rows_before(observations.shift_ticks)
    return observations.position[rows], observations.pressed[rows]


def farthest_points(places: Floats, count: int) -> Floats:
    """(count, 3) centres far from each other: each is the place that is farthest from those before it."""
    some = places[np.linspace(0, len(places) - 1, min(len(places), _CANDIDATES)).astype(int)]
    chosen = [some[int(np.argmin(((some - some.mean(axis=0)) ** 2).sum(axis=1)))]]
    nearest = ((some - chosen[0]) ** 2).sum(axis=1)
    while len(chosen) < count:
        chosen.append(some[int(np.argmax(nearest))])
        nearest = np.minimum(nearest, ((some - chosen[-1]) ** 2).sum(axis=1))
    return np.array(chosen)

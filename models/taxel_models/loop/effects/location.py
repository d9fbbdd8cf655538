"""Location: the error depends on where the contact is."""

from collections.abc import Iterable
from functools import partial
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.corrections import Places
from taxel_models.loop.basis import Floats, Shared
from taxel_models.loop.effects.effect import Candidate, Effect, Left, Online
from taxel_models.loop.evidence import TOUCH_N, Evidence
from taxel_models.loop.planting import Planting

CENTRES: Final = 16
HALF_FORCE_N: Final = 0.5
WIDTH: Final = 0.8
"""Of a bump, over the mean distance between neighbouring centres: bumps overlap smoothly."""

LEAST_SPREAD_M: Final = 2e-4
_CANDIDATES: Final = 2000


class Location(Effect):
    """Smooth bumps over the places that were touched, growing with the force."""

    name = "location"
    equation = "delta_c = |F|/(|F| + 0.5 N) sum_k w_ck exp(-|x - x_k|² / (2 s²))"
    source = "radial basis functions; the force's factor is 0 in free air and flattens as the skin does"
    signature = "the residual repeats wherever the same place is pressed, whenever that is"

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        position, pressed = _served(evidence)
        touched = position[left.fit & (pressed > TOUCH_N)]
        if len(touched) < CENTRES or touched.std(axis=0).max() < LEAST_SPREAD_M:
            return
        centres = spread_out(touched, CENTRES)
        distances = np.linalg.norm(centres[:, None] - centres[None], axis=2)
        spacing = float(np.partition(distances, 1, axis=1)[:, 1].mean())
        yield self._with(centres, WIDTH * max(spacing, LEAST_SPREAD_M), evidence)

    def _with(self, centres: Floats, width: float, evidence: Evidence) -> Candidate:
        def online(weights: Floats) -> Online:
            term = Places(
                centres=tuple(tuple(centre) for centre in centres.tolist()),
                width=width,
                half_force=HALF_FORCE_N,
                weights=tuple(tuple(row) for row in weights.T.tolist()),
            )
            return Online((term,))

        return Candidate(
            self.name,
            f"{len(centres)} bumps",
            Shared(bumps(*_served(evidence), centres, width)),
            weight_names=tuple(f"bump {number}" for number in range(1, len(centres) + 1)),
            weight_unit="counts",
            settled={"width": (width * 1e3, "mm")},
            online=online,
            again=partial(self._with, centres, width),
        )

    @override
    def plant(self, planting: Planting) -> None:
        samples = planting.recording.samples
        touched = samples.position[planting.pressed > TOUCH_N]
        centres = spread_out(touched, 6)
        width = float(np.linalg.norm(touched.std(axis=0))) * 0.5
        weights = planting.random.normal(size=(6, len(CHANNELS))) * planting.residual
        planting.add(
            bumps(samples.position, planting.pressed, centres, width) @ weights, {}, width=width * 1e3
        )


def _served(evidence: Evidence) -> tuple[Floats, Floats]:
    """(n, 3) positions and (n,) forces' magnitudes as a served window has them: before a lag, if any."""
    rows = evidence.rows_before(evidence.shift_ticks)
    return evidence.position[rows], evidence.pressed[rows]


def bumps(position: Floats, pressed: Floats, centres: Floats, width: float) -> Floats:
    """(n, k) of positions (n, 3) m and forces (n,) N, as `Places` has them."""
    squared = ((position[:, None] - centres[None]) ** 2).sum(axis=2)
    return np.asarray((pressed / (pressed + HALF_FORCE_N))[:, None] * np.exp(-squared / (2 * width**2)))


def spread_out(places: Floats, count: int) -> Floats:
    """(count, 3) of the places, far from each other: each the farthest from those before it."""
    some = places[np.linspace(0, len(places) - 1, min(len(places), _CANDIDATES)).astype(int)]
    chosen = [some[int(np.argmin(((some - some.mean(axis=0)) ** 2).sum(axis=1)))]]
    nearest = ((some - chosen[0]) ** 2).sum(axis=1)
    while len(chosen) < count:
        chosen.append(some[int(np.argmax(nearest))])
        nearest = np.minimum(nearest, ((some - chosen[-1]) ** 2).sum(axis=1))
    return np.array(chosen)

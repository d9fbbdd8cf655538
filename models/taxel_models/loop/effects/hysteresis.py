"""Hysteresis: loading and unloading differ at any speed."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.windows import Direction, Play
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining, past, weighted
from taxel_models.loop.observations import Observations

NARROWEST_N: Final = 0.05
WIDEST: Final = 0.6
"""The widest play over the range of forces; a wider one hardly moves."""

LEAST_RANGE_N: Final = 3.0
WIDTHS: Final = 12
SEVERAL: Final = (1 / 64, 1 / 16, 1 / 4, 1.0)
"""Widths over the widest that together make a smooth loop (Prandtl and Ishlinskii)."""

FINER: Final = (0.84, 0.91, 1.1, 1.19)
"""Factors of finer widths; neighbours on the grid differ by a factor of 1.4."""


class Hysteresis(Effect):
    """The channel follows the force with play: after a reversal, it waits until a width is passed."""

    name = "hysteresis"
    equation = "delta_c = w_c (H - |F|), H = min(max(H, |F| - width), |F| + width)"
    source = "play operator (Krasnosel'skii and Pokrovskii 1989); no published constants for the sensor"
    signature = "loading and unloading differ by as much when time runs faster or slower"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        low, high = np.quantile(observations.pressed, (0.01, 0.99))
        widest = WIDEST * max(float(high - low), LEAST_RANGE_N)
        for width in np.geomspace(NARROWEST_N, widest, WIDTHS).tolist():
            yield self._with(observations, width)
        several = [widest * share for share in SEVERAL]
        plays = [past(observations, Play(of="force", width_n=w), f"play[{w:.3g}N].force", "N") for w in several]
        told = ", ".join(f"{width:.3g}" for width in several)
        yield weighted(
            observations, self.name, f"plays of {told} N", "unit", plays, weight_unit="counts/N"
        )
        direction = Direction(of="force")
        yield weighted(
            observations,
            self.name,
            "by direction",
            "unit",
            [past(observations, direction, "direction.force", "N")],
            weight_unit="counts/N",
        )

    @override
    def finer(self, observations: Observations, best: Candidate) -> Iterable[Candidate]:
        if "width" in best.form_parameters:
            for factor in FINER:
                yield self._with(observations, best.form_parameters["width"][0] * factor)

    def _with(self, observations: Observations, width: float) -> Candidate:
        feature = Play(of="force", width_n=width)
        return weighted(
            observations,
            self.name,
            f"play of {width:.3g} N",
            "unit",
            [past(observations, feature, f"play[{width:.3g}N].force", "N")],
            form_parameters={"width": (width, "N")},
            weight_unit="counts/N",
        )

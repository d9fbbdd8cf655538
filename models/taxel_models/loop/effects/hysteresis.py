"""Hysteresis: loading and unloading differ at any speed."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.windows import Direction, Play
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining, past, weighted
from taxel_models.loop.observations import Observations

WIDTHS_N: Final = tuple(np.geomspace(0.05, 2.0, 12).tolist())
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
        for width in WIDTHS_N:
            yield self._with(observations, width)
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

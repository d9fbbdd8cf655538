"""Hysteresis: loading and unloading differ at any speed."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.windows import Direction, Friction, HistoryFeature, Play
from taxel_models.loop.effects.drivers import past, weighted
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining
from taxel_models.loop.observations import Observations

PLAYS_N: Final = tuple(np.geomspace(0.05, 2.0, 12).tolist())
FRICTIONS_N: Final = tuple(np.geomspace(0.1, 5.6, 12).tolist())
FINER: Final = (0.84, 0.91, 1.1, 1.19)
"""Factors of finer widths; neighbours on the grids differ by a factor of 1.4."""

WIDEST: Final = 0.5
"""The largest width of a friction, over the force that 95 % of the rows stay below: a wider one hardly
turns, and is as good as the force itself. Likewise of a play, over the usual travel of the force in a
segment: a wider one stays where it began, and is as good as the segment's first force."""


class Hysteresis(Effect):
    """The channel follows the force with play or friction: after a reversal, it stays behind by a width."""

    name = "hysteresis"
    equation = (
        "delta_c = w_c (H - |F|): play, H = min(max(H, |F| - width), |F| + width); "
        "or friction, d(H - |F|) = -d|F| - |d|F|| (H - |F|) / width"
    )
    source = (
        "play operator (Krasnosel'skii and Pokrovskii 1989), friction (Dahl 1968); "
        "no published constants for the sensor"
    )
    signature = "loading and unloading differ by as much when time runs faster or slower"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        yield from self._plays(observations, PLAYS_N)
        yield from self._frictions(observations, FRICTIONS_N)
        direction = Direction(of="force")
        yield weighted(
            observations,
            self.name,
            "by direction",
            "unit",
            [past(observations, direction, "direction.force", "N")],
            weight_units=("counts/N",),
        )

    @override
    def finer(
        self, observations: Observations, best: Candidate, fit: NDArray[np.bool_]
    ) -> Iterable[Candidate]:
        for name, forms in (("play", self._plays), ("friction", self._frictions)):
            if best.form.startswith(name):
                width, _ = best.form_parameters["width"]
                yield from forms(observations, [width * factor for factor in FINER])

    def _plays(self, observations: Observations, widths: Iterable[float]) -> Iterable[Candidate]:
        widest = WIDEST * observations.usual_travel_n
        for width in widths:
            if width <= widest:
                yield self._with(observations, "play", width, Play(of="force", width_n=width))

    def _frictions(self, observations: Observations, widths: Iterable[float]) -> Iterable[Candidate]:
        widest = WIDEST * float(np.quantile(observations.pressed, 0.95))
        for width in widths:
            if width <= widest:
                yield self._with(observations, "friction", width, Friction(of="force", width_n=width))

    def _with(
        self, observations: Observations, name: str, width: float, feature: HistoryFeature
    ) -> Candidate:
        return weighted(
            observations,
            self.name,
            f"{name} of {width:.3g} N",
            "unit",
            [past(observations, feature, f"{name}[{width:.3g}N].force", "N")],
            form_parameters={"width": (width, "N")},
            weight_units=("counts/N",),
        )

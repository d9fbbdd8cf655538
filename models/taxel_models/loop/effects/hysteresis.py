"""Hysteresis: loading and unloading differ, however slowly they happen."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.windows import Direction, Play
from taxel_models.loop.effects.effect import Candidate, Effect, Left, past, weighted
from taxel_models.loop.evidence import Evidence
from taxel_models.loop.planting import Planting

WIDTHS_N: Final = tuple(np.geomspace(0.05, 2.0, 12).tolist())
FINER: Final = (0.84, 0.91, 1.1, 1.19)
"""Widths between two of the grid, which is 1.4 apart."""


class Hysteresis(Effect):
    """The channel answers to the force with play: it waits until the force has turned by a width."""

    name = "hysteresis"
    equation = "delta_c = w_c (H - |F|), H = min(max(H, |F| - width), |F| + width)"
    source = "play operator (Krasnosel'skii and Pokrovskii 1989); no published constants for the sensor"
    signature = "loading and unloading differ by as much when time runs faster or slower"

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        for width in WIDTHS_N:
            yield self._with(evidence, width)
        direction = Direction(of="force")
        yield weighted(
            evidence,
            self.name,
            "by direction",
            "unit",
            [past(evidence, direction, "direction.force", "N")],
            weight_unit="counts/N",
        )

    @override
    def finer(self, evidence: Evidence, best: Candidate) -> Iterable[Candidate]:
        if "width" in best.settled:
            for factor in FINER:
                yield self._with(evidence, best.settled["width"][0] * factor)

    def _with(self, evidence: Evidence, width: float) -> Candidate:
        feature = Play(of="force", width_n=width)
        return weighted(
            evidence,
            self.name,
            f"play of {width:.3g} N",
            "unit",
            [past(evidence, feature, f"play[{width:.3g}N].force", "N")],
            settled={"width": (width, "N")},
            weight_unit="counts/N",
        )

    @override
    def plant(self, planting: Planting) -> None:
        width = float(np.exp(planting.random.uniform(np.log(0.15), np.log(1.0))))
        feature = Play(of="force", width_n=width)
        weights = planting.random.normal(0.0, 1.0, len(CHANNELS)) * planting.residual
        planting.add(planting.history(feature)[:, None] * weights, {"weight": weights}, width=width)

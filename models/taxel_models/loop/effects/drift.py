"""Drift: a slow function of the time since the session began."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel_models.loop.effects.effect import Candidate, Effect, Left, elapsed, weighted
from taxel_models.loop.evidence import Evidence
from taxel_models.loop.planting import Planting

PIECES: Final = 6
"""Straight pieces of a drift that is no line: enough for one rise or one swing over a session."""

SHORTEST_S: Final = 60.0


class Drift(Effect):
    """measured = model + d(t), a line or straight pieces; after the recording's end it stays."""

    name = "drift"
    equation = "delta_c = sum_k w_ck clip(t, t_k, t_k+1)"
    source = "warm-up of an idle finger: one exponential of 220 to 270 s (LASA recordings)"
    signature = "the residual moves with the clock, in free air as in contact, and follows no temperature"

    @override
    def forms(self, evidence: Evidence, left: Left) -> Iterable[Candidate]:
        span = float(evidence.time_s.max())
        if span < SHORTEST_S:
            return
        for form, edges in (
            ("line", np.array([0.0, span])),
            (f"{PIECES} pieces", np.linspace(0.0, span, PIECES + 1)),
        ):
            drivers = elapsed(evidence, edges)
            yield weighted(evidence, self.name, form, "unit", drivers, weight_unit="counts/s")

    @override
    def plant(self, planting: Planting) -> None:
        time = planting.time_s / planting.time_s[-1]
        rise = 1.0 - np.exp(-time / planting.random.uniform(0.2, 1.0))
        shape = time if planting.random.random() < 0.5 else rise
        amplitudes = planting.random.normal(1.0, 0.5, len(CHANNELS)) * planting.random.choice([-1.0, 1.0])
        planting.add((shape - shape.mean())[:, None] * amplitudes, {"amplitude": amplitudes})

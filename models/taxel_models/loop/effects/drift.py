"""Drift: a slow function of the time since the session began."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel_models.loop.effects.effect import Candidate, Effect, Remaining, elapsed, weighted
from taxel_models.loop.observations import Observations

PIECES: Final = 6
"""The straight pieces of a drift that is not a line: enough for one rise or one swing over a session."""

SHORTEST_S: Final = 60.0


class Drift(Effect):
    """measured = model + d(t); d is a line or straight pieces, and constant after the recording's end."""

    name = "drift"
    equation = "delta_c = sum_k w_ck clip(t, t_k, t_k+1)"
    source = "warm-up of an idle finger: one exponential of 220 to 270 s (LASA recordings)"
    signature = "the residual moves with the clock, in free air as in contact, and follows no temperature"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        span = float(observations.time_s.max())
        if span < SHORTEST_S:
            return
        for form, edges in (
            ("line", np.array([0.0, span])),
            (f"{PIECES} pieces", np.linspace(0.0, span, PIECES + 1)),
        ):
            drivers = elapsed(observations, edges)
            yield weighted(observations, self.name, form, "unit", drivers, weight_unit="counts/s")

"""Drift: a slow function of the time since the session began."""

from collections.abc import Iterable
from functools import partial
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel_models.loop.basis import Shared
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining, elapsed, evenly_filled, weighted
from taxel_models.loop.observations import Observations

PIECES: Final = 6
"""The straight pieces of a drift that is not a line: enough for one rise or one swing over a session."""

SHORTEST_S: Final = 60.0

WARMING: Final = (0.06, 0.15, 0.4)
"""Time constants of an exponential over the session's length; a longer one is a line."""

STRAIGHT: Final = 8
"""The straight pieces that an exponential is served as."""


class Drift(Effect):
    """measured = model + d(t); d is a line, an exponential or straight pieces.

    It is constant after the end of the recording.
    """

    name = "drift"
    is_steady = True
    equation = "delta_c = sum_k w_ck clip(t, t_k, t_k+1)"
    source = "warm-up of an idle finger: one exponential of 220 to 270 s (LASA recordings)"
    signature = "the residual moves with the clock, in free air as in contact, and follows no temperature"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        span = float(observations.time_s.max())
        if span < SHORTEST_S:
            return
        for form, pieces in (("line", 1), (f"{PIECES} pieces", PIECES)):
            drivers = elapsed(observations, evenly_filled(observations, pieces))
            yield weighted(observations, self.name, form, "unit", drivers, weight_unit="counts/s")
        for share in WARMING:
            yield _warming(self.name, share * span, span, observations)


def _warming(name: str, tau: float, span: float, observations: Observations) -> Candidate:
    """1 - exp(-t / tau), by straight pieces between points that it passes through."""
    edges = -tau * np.log1p(-np.linspace(0.0, 1.0, STRAIGHT + 1) * -np.expm1(-span / tau))
    edges[-1] = span
    slopes = np.diff(-np.expm1(-edges / tau)) / np.diff(edges)
    form = f"an exponential of {tau:.3g} s"
    pieces = weighted(observations, name, form, "unit", elapsed(observations, edges))
    course = pieces.basis.times(np.broadcast_to(slopes, (len(CHANNELS), STRAIGHT)))[:, :1]
    return Candidate(
        name,
        form,
        Shared(course),
        weight_names=("size",),
        weight_unit="counts",
        form_parameters={"time_constant": (tau, "s")},
        online=lambda weights: pieces.online(weights * slopes),
        again=partial(_warming, name, tau, span),
    )

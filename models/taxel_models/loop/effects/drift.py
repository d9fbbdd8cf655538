"""Drift: a slow function of the time since the session began."""

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.channels import CHANNELS
from taxel.windows import PERIOD_NS
from taxel_models.loop.basis import Floats, Shared
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining, elapsed, evenly_filled, weighted
from taxel_models.loop.observations import Observations

PIECES: Final = 6
"""The straight pieces of a drift that is not a line: enough for one rise or one swing over a session."""

SHORTEST_S: Final = 60.0

WARMING: Final = (0.06, 0.15, 0.4)
"""Time constants of an exponential over the session's length; a longer one is a line."""

FINER: Final = (0.62, 0.79, 1.26, 1.6)
"""Factors of finer time constants; neighbours on the grid differ by a factor of 2.6."""

STRAIGHT: Final = 8
"""The straight pieces that an exponential is served as."""

RECORDED: Final = 16
"""The straight pieces of a course in recorded time, with as many rows in each; pauses have their own."""

LONG_PAUSE: Final = 0.05
"""The least share of a session that counts as a pause: a drift by the clock goes on in it."""


class Drift(Effect):
    """measured = model + d(t); d is a line, an exponential or straight pieces.

    A line and an exponential are also tried in the time that was recorded: with long pauses, such as
    nights, a finger that changes while it is used does not follow the clock. d is constant after the end
    of the recording.
    """

    name = "drift"
    is_steady = True
    equation = "delta_c = sum_k w_ck clip(t, t_k, t_k+1)"
    source = "warm-up of an idle finger: one exponential of 220 to 270 s (LASA recordings)"
    signature = "the residual moves with the clock, in free air as in contact, and follows no temperature"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        time = observations.time_s
        span = float(time.max())
        if span < SHORTEST_S:
            return
        for form, pieces in (("line", 1), (f"{PIECES} pieces", PIECES)):
            drivers = elapsed(observations, evenly_filled(observations, pieces))
            yield weighted(observations, self.name, form, "unit", drivers, weight_unit="counts/s")
        for share in WARMING:
            yield _exponential(share * span, "s", observations)
        if (np.diff(time) > LONG_PAUSE * span).any():
            edges, recorded_s = _recorded(observations)
            yield _along("line in recorded time", {}, edges, recorded_s / recorded_s[-1], observations)
            for share in WARMING:
                yield _exponential(share * float(recorded_s[-1]), "s recorded", observations)

    @override
    def finer(self, observations: Observations, best: Candidate) -> Iterable[Candidate]:
        if "time_constant" in best.form_parameters:
            tau, unit = best.form_parameters["time_constant"]
            for factor in FINER:
                yield _exponential(factor * tau, unit, observations)


def _exponential(tau: float, unit: str, observations: Observations) -> Candidate:
    """1 - exp(-t / tau), where t is the session's time (`s`), or what was recorded of it (`s recorded`)."""
    if unit == "s":
        span = float(observations.time_s.max())
        # Each piece goes as far as the others.
        edges = -tau * np.log1p(-np.linspace(0.0, 1.0, STRAIGHT + 1) * -np.expm1(-span / tau))
        edges[-1] = span
        elapsed_s = edges
    else:
        edges, elapsed_s = _recorded(observations)
    parameters = {"time_constant": (tau, unit)}
    course = -np.expm1(-elapsed_s / tau)
    return _along(f"an exponential of {tau:.3g} {unit}", parameters, edges, course, observations)


def _recorded(observations: Observations) -> tuple[Floats, Floats]:
    """Edges of the session's time (k + 1,), s, and how much was recorded until each, s."""
    time = observations.time_s
    pauses = np.flatnonzero(np.diff(time) > LONG_PAUSE * time.max())
    edges = np.union1d(evenly_filled(observations, RECORDED), [time[pauses], time[pauses + 1]])
    return edges, np.searchsorted(time, edges) * PERIOD_NS / 1e9


def _along(
    form: str,
    parameters: Mapping[str, tuple[float, str]],
    edges: Floats,
    course: Floats,
    observations: Observations,
) -> Candidate:
    """A course through given values at the edges (k + 1,), by straight pieces."""
    slopes = np.diff(course) / np.diff(edges)
    pieces = weighted(observations, Drift.name, form, "unit", elapsed(observations, edges))
    values = pieces.basis.times(np.broadcast_to(slopes, (len(CHANNELS), len(slopes))))[:, :1]
    return Candidate(
        Drift.name,
        form,
        Shared(values),
        weight_names=("size",),
        weight_unit="counts",
        form_parameters=dict(parameters),
        online=lambda weights: pieces.online(weights * slopes),
        again=partial(_along, form, parameters, edges, course),
    )

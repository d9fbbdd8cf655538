"""Creep: after the load changes, a channel relaxes with a time constant."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from typing_extensions import override

from taxel.windows import Relaxation, RelaxationShare
from taxel.windows.history import Followed
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining, past, weighted
from taxel_models.loop.observations import Observations

SHORTEST_S: Final = 0.08
SHORTEST_BY_FORCE_S: Final = 0.12
"""What a force makes relax faster is over within a few samples, and cannot be told from its rate."""

LONGEST_S: Final = 40.0
"""The load changes often, so a longer time constant looks like a gain."""

OBSERVED: Final = 0.5
"""The longest time constant over the usual length of a segment."""

GRID: Final = np.geomspace(SHORTEST_S, LONGEST_S, 11)
_OF_SIGNAL: Final = "of the channel's signal"
_DIRECTION: Final = "and its direction"
_EVERY: Final[tuple[Followed, ...]] = ("force", "fx", "fy", "fz")
FINER: Final = np.array([0.72, 0.85, 1.18, 1.39])
"""Factors of finer time constants; neighbours on the grid differ by a factor of 1.9."""


class Creep(Effect):
    """The channel responds to the force less its low-pass."""

    name = "creep"
    equation = "delta_c = sum_u w_cu (L_tau u - u), L_tau a first-order low-pass, u of |F|, Fx, Fy, Fz"
    source = "standard linear solid (Findley, Lai and Onaran 1976); no published constants for the sensor"
    signature = "the residual decays after each change of load, over a time of its own"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        for tau in GRID[_longest_s(observations) >= GRID]:
            if tau >= SHORTEST_BY_FORCE_S:
                yield self._by_force(observations, float(tau))
            yield self._of_signal(observations, float(tau))

    @override
    def finer(self, observations: Observations, best: Candidate) -> Iterable[Candidate]:
        tau = best.form_parameters["time_constant"][0]
        longest = _longest_s(observations)
        for factor in FINER[tau * FINER <= longest]:
            if best.form.startswith(_OF_SIGNAL):
                yield self._of_signal(observations, tau * float(factor))
            elif tau * factor < SHORTEST_BY_FORCE_S:
                continue
            elif _DIRECTION in best.form:
                yield self._by_force(observations, tau * float(factor), _EVERY)
            else:
                yield self._by_force(observations, tau * float(factor))
        if _DIRECTION not in best.form:
            yield self._by_force(observations, tau, _EVERY)

    def _by_force(
        self, observations: Observations, tau: float, of: tuple[Followed, ...] = ("force",)
    ) -> Candidate:
        drivers = [
            past(
                observations,
                Relaxation(of=which, time_constant_s=tau),
                f"relaxation[{tau:.3g}s].{which}",
                "N",
            )
            for which in of
        ]
        return weighted(
            observations,
            self.name,
            f"by force{f' {_DIRECTION}' if len(of) > 1 else ''}, {tau:.3g} s",
            "unit",
            drivers,
            form_parameters={"time_constant": (tau, "s")},
            weight_unit="counts/N",
        )

    def _of_signal(self, observations: Observations, tau: float) -> Candidate:
        share = RelaxationShare(of="force", time_constant_s=tau)
        return weighted(
            observations,
            self.name,
            f"{_OF_SIGNAL}, {tau:.3g} s",
            "signal",
            [past(observations, share, f"relaxation_share[{tau:.3g}s].force", "1")],
            centred=False,
            form_parameters={"time_constant": (tau, "s")},
            weight_unit="relative",
        )


def _longest_s(observations: Observations) -> float:
    """The longest time constant, s: a memory that outlasts the contacts cannot be told from a gain."""
    return min(max(OBSERVED * observations.usual_segment_s, SHORTEST_S), LONGEST_S)

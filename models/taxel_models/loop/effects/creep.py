"""Creep: after the load changes, a channel relaxes with a time constant."""

from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.windows import Relaxation, RelaxationShare
from taxel.windows.history import TICK_S, Followed, Starts
from taxel_models.loop.effects.drivers import past, weighted
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining
from taxel_models.loop.observations import Observations

SHORTEST_S: Final = 0.08
SHORTEST_BY_FORCE_S: Final = 0.12
"""What a force makes relax faster is over within a few samples, and cannot be told from its rate."""

SHORTEST_OTHER_S: Final = 0.3
"""A faster low-pass is as good as the force, and a faster start from rest as the edge of a delayed file."""

LONGEST_S: Final = 40.0
"""The load changes often, so a longer time constant looks like a gain."""

OF_RECORDING: Final = 0.1
"""The longest time constant of a low-pass over the recorded time: a slower one looks like a drift."""

GRID: Final = np.geomspace(SHORTEST_S, LONGEST_S, 11)
_OF_SIGNAL: Final = "of the channel's signal"
_EVERY: Final[tuple[Followed, ...]] = ("force", "fx", "fy", "fz")
FINER: Final = np.array([0.72, 0.85, 1.18, 1.39])
"""Factors of finer time constants; neighbours on the grid differ by a factor of 1.9."""


class ByForce(NamedTuple):
    """How a channel follows the force's low-pass.

    Attributes:
        whole: whether it follows the low-pass itself, or what the low-pass is ahead of the force.
            A trained model may lack the one or the other.
        starts: what a segment begins with: a load that has been there for long, or a new one.
        directions: whether it also follows fx, fy and fz.
    """

    whole: bool
    starts: Starts
    directions: bool = False

    def feature(self, tau: float, of: Followed = "force") -> Relaxation:
        """What is followed, with a time constant, s."""
        return Relaxation(of=of, time_constant_s=tau, starts=self.starts, whole=self.whole)

    def allows(self, tau: float, observations: Observations) -> bool:
        """Whether a time constant, s, can be told from the load and from a drift."""
        usual = not self.whole and self.starts == "settled"
        if tau < (SHORTEST_BY_FORCE_S if usual else SHORTEST_OTHER_S):
            return False
        return not self.whole or tau <= OF_RECORDING * len(observations) * TICK_S

    def __str__(self) -> str:
        return (
            f"by {'low-passed force' if self.whole else 'force'}"
            f"{' and its direction' if self.directions else ''}"
            f"{', from rest' if self.starts == 'rest' else ''}"
        )


BY_FORCE: Final = [ByForce(whole, starts) for whole in (False, True) for starts in ("settled", "rest")]


class Creep(Effect):
    """The channel responds to the force's low-pass, or to it less the force."""

    name = "creep"
    equation = (
        "delta_c = sum_u w_cu (L_tau u - u) or w_cu L_tau u, "
        "L_tau a first-order low-pass, u of |F|, Fx, Fy, Fz"
    )
    source = "standard linear solid (Findley, Lai and Onaran 1976); no published constants for the sensor"
    signature = "the residual decays after each change of load, over a time of its own"

    @override
    def forms(self, observations: Observations, remaining: Remaining) -> Iterable[Candidate]:
        told = observations.starts_pressed
        by_force = [how for how in BY_FORCE if told or how.starts == "settled"]
        for tau in GRID[_longest_s(observations) >= GRID].tolist():
            for how in by_force:
                if how.allows(tau, observations):
                    yield self._by_force(observations, tau, how)
            yield self._of_signal(observations, tau)

    @override
    def finer(
        self, observations: Observations, best: Candidate, fit: NDArray[np.bool_]
    ) -> Iterable[Candidate]:
        tau = best.form_parameters["time_constant"][0]
        taus = (tau * FINER[tau * FINER <= _longest_s(observations)]).tolist()
        if best.form.startswith(_OF_SIGNAL):
            for finer in taus:
                yield self._of_signal(observations, finer)
            return
        told = best.form_itself.rpartition(", ")[0]
        how = next(
            how for one in BY_FORCE for how in (one, one._replace(directions=True)) if str(how) == told
        )
        for finer in taus:
            if how.allows(finer, observations):
                yield self._by_force(observations, finer, how)
        if not how.directions:
            yield self._by_force(observations, tau, how._replace(directions=True))

    def _by_force(self, observations: Observations, tau: float, how: ByForce) -> Candidate:
        kind, rest = "low_pass" if how.whole else "relaxation", how.starts == "rest"
        drivers = [
            past(
                observations,
                how.feature(tau, which),
                f"{kind}[{tau:.3g}s{', from rest' if rest else ''}].{which}",
                "N",
            )
            for which in (_EVERY if how.directions else _EVERY[:1])
        ]
        return weighted(
            observations,
            self.name,
            f"{how}, {tau:.3g} s",
            "unit",
            drivers,
            form_parameters={"time_constant": (tau, "s")},
            weight_units=("counts/N",),
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
            weight_units=("relative",),
        )


def _longest_s(observations: Observations) -> float:
    """The longest time constant, s: a memory that outlasts the contacts cannot be told from a gain."""
    return min(max(observations.usual_segment_s, SHORTEST_S), LONGEST_S)

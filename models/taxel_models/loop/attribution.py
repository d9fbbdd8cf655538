"""What an attribution found: effects that were named, and those that were not."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.effects.fault import Fault
from taxel_models.loop.effects.interference import Interference
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.findings import ParameterCorrelation, RejectedEffect
from taxel_models.loop.observations import Observations

AS_USUAL: Final = "does not repeat beyond what the model's own held-out residual has of it"
"""Why an effect was not named that is usual of the model; `--no-reference` names such an effect."""


@dataclass(frozen=True)
class Named:
    """An effect that was named.

    Attributes:
        candidate: the form that was taken.
        equation: what it adds to a channel.
        weights: (21, k), the posterior mean by the fit part, beside the other named effects.
        fold_weights: (folds, 21, k) by the fit part without each fold, without the prior that shrinks
            `weights`; empty where nothing is fitted.
        served_share: (21,) of these weights, the part that single rows are best predicted with.
        contribution: (n, 21) what that part adds to the prediction, counts.
        log_evidence: logarithm of the odds with it to those without it, when it was named.
        included: (21,) probability that each channel has it.
        p_value: one-sided, of the t over held-out folds, when it was named.
        confounded_with: effects that could replace it.
        conditional: the share of the fit part's energy that is lost without it.
        unknown: (21, k) how far the model's own error leaves each weight open, half of a 95 % interval.
    """

    candidate: Candidate
    equation: str
    weights: Floats
    fold_weights: Floats
    served_share: Floats
    contribution: Floats
    log_evidence: float
    included: Floats
    p_value: float
    confounded_with: tuple[str, ...] = ()
    conditional: float = 0.0
    unknown: Floats | float = 0.0

    @property
    def name(self) -> str:
        """The effect's."""
        return self.candidate.effect

    @property
    def served_weights(self) -> Floats:
        """(21, k), those of the corrected model."""
        return self.weights * self.served_share[:, None]

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that it changes."""
        return tuple(name for name, changed in zip(CHANNELS, self.changed, strict=True) if changed)

    @property
    def changed(self) -> NDArray[np.bool_]:
        """(21,) channels that it changes."""
        return np.asarray(np.abs(self.contribution).max(axis=0) > 0)


def in_order(named: Sequence[Named]) -> tuple[Named, ...]:
    """Named effects, a fault and a constant behind those that explain more; the others keep their order.

    A fault of one channel beside a cause of all is often its consequence: a drift leads to a limit. A
    constant is often the mean of another cause.
    """
    ordered = [one for one in named if one.name != Fault.name]
    for fault in (one for one in named if one.name == Fault.name):
        more = [place for place, other in enumerate(ordered, 1) if other.conditional > fault.conditional]
        ordered.insert(max(more, default=0), fault)
    for constant in (one for one in named if one.name == Offset.name):
        place = ordered.index(constant)
        later = enumerate(ordered[place + 1 :], place + 1)
        more = [behind for behind, other in later if other.conditional > constant.conditional]
        ordered.insert(max(more, default=place), ordered.pop(place))
    return tuple(ordered)


@dataclass(frozen=True)
class Attribution:
    """What was found.

    Attributes:
        observations: with the inputs put right, where an effect moves them.
        named: in the order in which they were found, a fault and a constant behind those that explain more.
        rejected: the others.
        residual: (n, 21) what is left, counts.
        correlation: between the weights of the named effects; None where fewer than two are fitted.
    """

    observations: Observations
    named: tuple[Named, ...]
    rejected: tuple[RejectedEffect, ...]
    residual: Floats
    correlation: ParameterCorrelation | None = None

    @property
    def waves(self) -> Floats:
        """(n, 21) named interference, counts."""
        waves = [one.contribution for one in self.named if one.name == Interference.name]
        return np.asarray(np.sum([np.zeros_like(self.residual), *waves], axis=0))

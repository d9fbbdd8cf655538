"""What an attribution found: effects that were named, and those that were not."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_models.loop.basis import Floats
from taxel_models.loop.cross_validation import Score
from taxel_models.loop.effects.effect import Effect
from taxel_models.loop.observations import Observations


@dataclass(frozen=True)
class Named:
    """An effect that was named.

    Attributes:
        effect: which.
        score: of the form that was taken, when it was.
        weights: (21, k), fitted to the fit part beside the other named ones.
        contribution: (n, 21) what it adds to the prediction, counts.
        p_value: chance of so much by blocks turned round, the most of all candidates.
        confounded_with: effects that explain nearly as much in its place.
        conditional: share of the fit part's energy that is lost without it, the others fitted anew.
    """

    effect: Effect
    score: Score
    weights: Floats
    contribution: Floats
    p_value: float
    confounded_with: tuple[str, ...] = ()
    conditional: float = 0.0

    @property
    def name(self) -> str:
        """The effect's."""
        return self.score.candidate.effect

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that it changes."""
        return tuple(name for name, changed in zip(CHANNELS, self.changed, strict=True) if changed)

    @property
    def changed(self) -> NDArray[np.bool_]:
        """(21,) channels that it changes."""
        return np.asarray(np.abs(self.contribution).max(axis=0) > 0)


@dataclass(frozen=True)
class Rejected:
    """The best form of an effect that was not named in the end.

    Attributes:
        share: of what was left at the end that it explains in cross-validation.
        alone: of the first residual that it explained by itself.
    """

    name: str
    form: str
    share: float
    alone: float
    p_value: float
    reason: str


@dataclass(frozen=True)
class Attribution:
    """What was found.

    Attributes:
        observations: with the inputs put right, where an effect moves them.
        named: in the order in which they were named.
        rejected: the others.
        residual: (n, 21) what is left, counts.
    """

    observations: Observations
    named: tuple[Named, ...]
    rejected: tuple[Rejected, ...]
    residual: Floats

"""What an attribution found: effects that were named, and those that were not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_models.loop.basis import Floats
from taxel_models.loop.cross_validation import Score
from taxel_models.loop.effects.effect import Effect
from taxel_models.loop.model_selection import FOLD_LEVEL, LEVEL
from taxel_models.loop.observations import Observations


@dataclass(frozen=True)
class Named:
    """An effect that was named.

    Attributes:
        effect: which.
        score: of the form that was taken, when it was.
        weights: (21, k), fitted to the fit part together with the other named effects.
        contribution: (n, 21) what it adds to the prediction, counts.
        p_value: how often chance lets any candidate stand out as much, by random signs of blocks.
        confounded_with: effects that could replace it.
        conditional: the share of the fit part's energy that is lost without it.
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


def rejected(
    scores: Sequence[Score],
    p_values: Mapping[str, float],
    named: Sequence[Named],
    alone: Sequence[Score],
    scale: Floats,
) -> tuple[Rejected, ...]:
    """The effects that were not named, with the reason; those that explain most alone come first.

    Args:
        scores: the best forms on the residual of the named effects.
        p_values: their p-values, by effect.
        named: the named effects.
        alone: the best forms on the first residual.
        scale: (21,) what an error of each channel counts, 1/counts².
    """
    names = {other.name for other in named}
    shares = {score.candidate.effect: score.share for score in alone}
    confounded = {name for other in named for name in other.confounded_with}
    found = []
    for score in scores:
        name = score.candidate.effect
        if name in names:
            continue
        p_value = p_values[name]
        if name in confounded:
            reason = "cannot be told apart from an effect that was named and explains more"
        elif p_value > LEVEL:
            reason = "no more than chance gives"
        elif score.repeats > FOLD_LEVEL:
            reason = "stands out, but does not repeat over the folds"
        elif score.contradicts(scale):
            reason = "stands out, but its weights differ more than its cause allows"
        else:
            reason = "too little to matter"
        found.append(
            Rejected(name, score.candidate.form, score.share, shares.get(name, 0.0), p_value, reason)
        )
    return tuple(sorted(found, key=lambda other: -other.alone))

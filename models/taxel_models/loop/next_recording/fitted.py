"""Causes as they were fitted, ready to act on another recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from taxel.channels import CHANNELS
from taxel.corrections import CALIBRATION_AGE, CALIBRATION_EXTRAS, Term, Weighted
from taxel.held_out_residual import HeldOutResidual
from taxel.windows import Elapsed, ExtraFeature
from taxel_models.loop.attribution import Attribution, Named
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.correction import composed
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.effects.registry import effect_named
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.score import Taken
from taxel_models.loop.inference.scoring import Scoring
from taxel_models.loop.observations import Observations
from taxel_models.loop.status import silent


@dataclass(frozen=True)
class Fitted:
    """A cause in its likeliest form, with its weights.

    Attributes:
        candidate: the form.
        weights: (21, k).
    """

    candidate: Candidate
    weights: Floats

    @property
    def name(self) -> str:
        """The effect's."""
        return self.candidate.effect

    @classmethod
    def of(cls, named: Named) -> "Fitted":
        """As it was named."""
        return cls(named.candidate, named.served_weights)

    @property
    def foretells(self) -> bool:
        """Whether it says what it would do in another recording.

        What came about in the course of these recordings does not, nor what a calibration tells.
        """
        online = self.candidate.online(self.weights)
        calibrated = any(extra in (*CALIBRATION_EXTRAS, CALIBRATION_AGE) for extra in online.extras)
        return online.changes_something and not calibrated

    def counts(self, observations: Observations) -> Floats:
        """(n, 21) what the model gives on other observations with this cause, not rounded."""
        online = self.candidate.online(self.weights)
        moved = self.candidate.moved(observations) if self.candidate.moved else observations
        factor = _slower(online.extras, float(observations.time_s.max()))
        extras = [_stretched(extra, factor) for extra in online.extras]
        of_time = {extra.name for extra in extras if isinstance(extra.history, Elapsed)}
        terms = [_slowed(term, of_time, factor) for term in online.terms]
        return composed(observations, moved, terms, extras)


def _slower(extras: Sequence[ExtraFeature], span_s: float) -> float:
    """By how much a drift is slower over a longer recording, so that it changes as much in all as it did.

    A drift that was seen for a minute would lead anywhere in an hour.
    """
    ends = [extra.history.end_s for extra in extras if isinstance(extra.history, Elapsed)]
    return max(1.0, span_s / max(ends)) if ends else 1.0


def _stretched(extra: ExtraFeature, factor: float) -> ExtraFeature:
    if not isinstance(extra.history, Elapsed):
        return extra
    start, end = extra.history.start_s * factor, extra.history.end_s * factor
    return extra.model_copy(update={"history": Elapsed(start_s=start, end_s=end)})


def _slowed(term: Term, of_time: set[str], factor: float) -> Term:
    if not isinstance(term, Weighted):
        return term
    factors = [factor if name in of_time else 1.0 for name in term.features]
    references = tuple(value * own for value, own in zip(term.references, factors, strict=True))
    weights = tuple(
        tuple(weight / own for weight in row) for row, own in zip(term.weights, factors, strict=True)
    )
    return term.model_copy(update={"references": references, "weights": weights})


def fitted_in_place(
    first: Observations,
    blocks: Blocks,
    attribution: Attribution,
    named: Named,
    name: str,
    reference: HeldOutResidual | None,
    constants: Constants,
) -> Fitted | None:
    """Another cause in the place of a named one, beside the others; None if it has no form here.

    Args:
        first: the observations before any input was moved.
        blocks: the fit part and the evaluation part.
        name: of the other cause.
    """
    observations = first if named.candidate.moves else attribution.observations
    for other in attribution.named:
        if other is not named and not other.candidate.moves:
            observations = replace(observations, measured=observations.measured - other.contribution)
    scoring = Scoring(observations, blocks, [effect_named(name)], reference, constants, silent)
    score = next((score for score in scoring.scores([]) if score.name == name), None)
    if score is None:
        return None
    score = scoring.refined(score, [])
    ones = np.ones((len(CHANNELS), score.form.size))
    taken = Taken(score, score.form, ones, np.zeros_like(observations.residual))
    candidate = score.form.candidate
    return Fitted(candidate, ones if candidate.moves else scoring.weights(taken, []))

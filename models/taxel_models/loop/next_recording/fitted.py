"""Causes as they were fitted, ready to act on another recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from taxel.channels import CHANNELS
from taxel.corrections import Term, Weighted
from taxel.manifest import HeldOutResidual
from taxel.windows import Elapsed, ExtraFeature
from taxel_models.loop.attribution import Attribution, Named
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.correction import column_of, composed
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.effects.registry import effect_named
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.score import Taken
from taxel_models.loop.inference.scoring import Scoring
from taxel_models.loop.observations import Observations


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
        return cls(named.candidate, named.weights)

    def counts(self, observations: Observations) -> Floats:
        """(n, 21) what the model gives on other observations with this cause, not rounded."""
        online = self.candidate.online(self.weights)
        moved = self.candidate.moved(observations) if self.candidate.moved else observations
        extras, slower = _stretched(online.extras, float(observations.time_s.max()))
        means = {extra.name: float(column_of(observations, extra).mean()) for extra in extras}
        settling = {extra.name for extra in extras if _settles(extra)}
        terms = [_about(term, means, settling, slower) for term in online.terms]
        return composed(observations, moved, terms, extras)


def _stretched(
    extras: Sequence[ExtraFeature], span_s: float
) -> tuple[list[ExtraFeature], dict[str, float]]:
    """Features of time over a longer recording, and by how much each is slower there.

    A drift that was seen for a minute would lead anywhere in an hour. It changes as much in all as it did.
    """
    ends = [extra.history.end_s for extra in extras if isinstance(extra.history, Elapsed)]
    factor = max(1.0, span_s / max(ends)) if ends else 1.0
    found, slower = [], {}
    for extra in extras:
        if isinstance(extra.history, Elapsed):
            longer = Elapsed(start_s=extra.history.start_s * factor, end_s=extra.history.end_s * factor)
            slower[extra.name] = factor
            found.append(extra.model_copy(update={"history": longer}))
        else:
            found.append(extra)
    return found, slower


def _settles(extra: ExtraFeature) -> bool:
    """Whether a feature is 0 at rest."""
    return extra.history is not None and not isinstance(extra.history, Elapsed)


def _about(term: Term, means: Mapping[str, float], settling: set[str], slower: Mapping[str, float]) -> Term:
    """The same about this recording's means: a finger elsewhere in its warm-up is no offset."""
    if not isinstance(term, Weighted):
        return term
    pairs = list(zip(term.features, term.references, strict=True))
    references = [
        means[name] if name in means and name not in settling else reference for name, reference in pairs
    ]
    weights = [
        tuple((np.array(row) / slower.get(name, 1.0)).tolist())
        for name, row in zip(term.features, term.weights, strict=True)
    ]
    return term.model_copy(update={"references": tuple(references), "weights": tuple(weights)})


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
    scoring = Scoring(observations, blocks, [effect_named(name)], reference, constants, lambda _: None)
    score = next((score for score in scoring.scores([]) if score.name == name), None)
    if score is None:
        return None
    score = scoring.refined(score, [])
    ones = np.ones((len(CHANNELS), score.form.size))
    taken = Taken(score, score.form, ones, np.zeros_like(observations.residual))
    candidate = score.form.candidate
    return Fitted(candidate, ones if candidate.moves else scoring.weights(taken, []))

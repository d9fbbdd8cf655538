"""A score: what one effect explains, and how sure that is."""

from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np
from scipy import stats

from taxel.channels import CHANNELS
from taxel_models.evaluation.standard_error import corrected_standard_error
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Effect
from taxel_models.loop.inference.evidence import Weighed
from taxel_models.loop.inference.forms import WhitenedForm

UNSHRUNK: Final = 1e3
"""A prior size, over the channel's residual, that leaves weights as the recording gives them."""


@dataclass(frozen=True)
class Score:
    """What one effect explains beside the named ones.

    Attributes:
        effect: which.
        form: its likeliest.
        weighed: that form, in the likelier of the two bases.
        log_evidence: of all its forms together.
        gain: (folds, 21) fall of the held-out squared error, over the noise, beside a constant of each
            channel.
        worth: (21,) share of each channel's held-out squared error that goes.
        usual: (folds, 21) what was subtracted from the gain, since the model's own residual has it.
        needs_constant: whether its form stands beside a constant of each channel.
        log_evidence_alone: of that form without one.
        likeliest_gain: gain in all of its likeliest form, where a simpler one was preferred; else None.
        forms: how many figures each form fits, and its log evidence.
    """

    effect: Effect
    form: WhitenedForm
    weighed: Weighed
    log_evidence: float
    gain: Floats
    worth: Floats
    usual: Floats
    needs_constant: bool = False
    log_evidence_alone: float = -np.inf
    likeliest_gain: float | None = None
    forms: tuple[tuple[int, float], ...] = ()

    def evidence_within(self, freedom: int) -> float:
        """The log evidence of its likeliest form that fits at most so many figures; -inf without one."""
        return max((own for figures, own in self.forms if figures <= freedom), default=-np.inf)

    @property
    def name(self) -> str:
        """The effect's."""
        return self.form.candidate.effect

    @property
    def freedom(self) -> int:
        """How many figures it can fit."""
        return self.form.freedom

    @property
    def folds(self) -> int:
        """That it was tested on."""
        return len(self.gain)

    @property
    def total_gain(self) -> float:
        """Over the folds and the channels that change."""
        return float(self.gain[:, self.weighed.changes].sum())

    @property
    def most_gain(self) -> float:
        """The same of its likeliest form, whether a simpler one was preferred or not."""
        return self.total_gain if self.likeliest_gain is None else self.likeliest_gain

    @property
    def t(self) -> float:
        """Over held-out folds; see `t_over_folds`."""
        return t_over_folds(self.gain, self.weighed)

    @property
    def t_with_usual(self) -> float:
        """The same, with what the model's own residual has."""
        return t_over_folds(self.gain + self.usual, self.weighed)

    @property
    def channel_t(self) -> Floats:
        """(21,) of each channel alone."""
        return np.array([t_of_folds(own) for own in self.gain.T])

    @property
    def chance(self) -> float:
        """The part of chance's probability that each of the forms has that were compared (Bonferroni)."""
        return 1.0 / self.form.candidate.fitting.compared

    @property
    def p_value(self) -> float:
        """One-sided, of that t."""
        return float(stats.t.sf(self.t, max(self.folds - 1, 1)))


@dataclass(frozen=True)
class Taken:
    """A named effect while others are looked for.

    Attributes:
        score: when it was named.
        form: that is fitted: the score's, for the present predictions.
        weights: (21, k), beside the other named effects.
        contribution: (n, 21) what it adds, counts.
        served_share: (21,) of what its weights give, the part that single rows are best served with.
    """

    score: Score
    form: WhitenedForm
    weights: Floats
    contribution: Floats
    served_share: Floats = field(default_factory=lambda: np.ones(len(CHANNELS)))

    @property
    def name(self) -> str:
        """The effect's."""
        return self.score.name

    @property
    def effect(self) -> Effect:
        """Which it is."""
        return self.score.effect

    @property
    def weighed(self) -> Weighed:
        """Its evidence when it was named."""
        return self.score.weighed

    @property
    def without_prior(self) -> Self:
        """The same with weights that are not shrunk: by least squares."""
        return replace(self, score=replace(self.score, weighed=replace(self.weighed, strength=UNSHRUNK)))

    @property
    def stays(self) -> bool:
        """Whether it is named for good: it moves inputs, is certain, or no model can predict it."""
        candidate = self.form.candidate
        return candidate.moves or candidate.certain or not self.effect.is_predictable

    @property
    def is_regressor(self) -> bool:
        """Whether its weights are inferred together with those of others."""
        fitting = self.form.candidate.fitting
        return not (fitting.fixed or fitting.pooled or fitting.few_channels)


def t_over_folds(gain: Floats, weighed: Weighed) -> float:
    """The larger t of two tests over the folds, over the channels that change.

    The first test counts all these channels alike. The second weighs them by what the other folds show,
    since the noise of the other channels would hide an effect of a few. Under chance, a fold's gain is as
    likely below 0 as above, since it has no influence on its own weights. Square roots of the gains are
    tested, with their signs: that keeps the symmetry of chance, and a cause that acts in some folds more
    than in others, such as a warming finger, passes.

    Args:
        gain: (folds, 21).
    """
    some = gain[:, weighed.changes]
    others = np.maximum((some.sum(axis=0) - some) / max(len(some) - 1, 1), 0.0)
    weighted = (others * some).sum(axis=1) / np.maximum(others.sum(axis=1), 1e-12)
    return max(t_of_folds(some.sum(axis=1)), t_of_folds(weighted))


def t_of_folds(by_fold: Floats) -> float:
    """Of gains (folds,), by the corrected resampled t-test: each fold is tested by what the others show."""
    by_fold = np.sign(by_fold) * np.sqrt(np.abs(by_fold))
    error = corrected_standard_error(by_fold, 1.0 / max(len(by_fold) - 1, 1))
    return float(by_fold.mean()) / max(error, 1e-12)

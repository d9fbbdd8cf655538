"""The outcome: what each named effect adds in the end, and why the others were not named."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.loop.attribution import AS_USUAL, Named, in_order
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.findings import RejectedEffect
from taxel_models.loop.inference.proof import is_worth_calibrating, stands
from taxel_models.loop.inference.score import Score, Taken
from taxel_models.loop.inference.scoring import Scoring
from taxel_models.loop.observations import Observations

DOUBTED: Final = "an effect that does not repeat, or was taken out again, may be most of it"
"""The reason of an effect that proves itself and is not named."""


class Outcome:
    """What a selection came to.

    Args:
        observations: before any input was moved.
        blocks: the fit part and the evaluation part. The evaluation part is not used.
        scoring: of the selection.
    """

    def __init__(self, observations: Observations, blocks: Blocks, scoring: Scoring) -> None:
        self._scoring, self._fit = scoring, blocks.fit
        self._first = np.maximum((observations.residual[self._fit] ** 2).mean(axis=0), 1e-9)

    def fitted_to_rows(self, taken: Sequence[Taken]) -> list[Taken]:
        """Named effects with the share of each contribution that single rows are best served with.

        Weights are inferred from means of several rows. A driver that is noisy from row to row, such as a
        force's rate, would bring its noise into every prediction.
        """
        fitted = []
        left = self._scoring.residual(taken)[self._fit]
        for each in taken:
            candidate, own = each.form.candidate, each.contribution[self._fit]
            share, contribution = np.ones(len(CHANNELS)), each.contribution
            if not (candidate.moves or candidate.fitting.fixed) and each.effect.is_predictable:
                products = np.array([((left + own) * own).sum(axis=0), (own**2).sum(axis=0)])
                if candidate.fitting.pooled:
                    products = (products / self._scoring.whitening.scale**2).sum(axis=1, keepdims=True)
                share *= np.clip(products[0] / np.maximum(products[1], 1e-12), 0.0, 1.0)
                share[~own.any(axis=0)] = 1.0
                left = left + own * (1.0 - share)
                contribution = contribution * share
            fitted.append(replace(each, contribution=contribution, served_share=share))
        return fitted

    def named(self, taken: Sequence[Taken], confounded: Mapping[str, tuple[str, ...]]) -> tuple[Named, ...]:
        """The named effects as they are reported.

        Args:
            taken: they, fitted to rows.
            confounded: of each, the effects that could replace it.
        """
        left = self._scoring.residual(taken)[self._fit]
        return in_order([self._named(each, taken, left, confounded[each.name]) for each in taken])

    def _named(
        self, taken: Taken, every: Sequence[Taken], left: Floats, confounded: tuple[str, ...]
    ) -> Named:
        """One of the named effects, which leave some counts (fit rows, 21)."""
        lost = ((left + taken.contribution[self._fit]) ** 2).mean(axis=0) - (left**2).mean(axis=0)
        candidate = taken.form.candidate
        # An interval around a shrunk weight would miss the true one.
        beside = [each.without_prior for each in every if each is not taken]
        fold_weights = (
            np.empty(0)
            if candidate.fitting.fixed
            else self._scoring.fold_weights(taken.without_prior, beside)
        )
        counts = taken.effect.is_constant and candidate.weight_units == ("counts",)
        unknown = self._scoring.unknown_mean()[:, None] if counts else np.zeros_like(taken.weights)
        return Named(
            candidate=candidate,
            equation=taken.effect.equation,
            weights=taken.weights,
            fold_weights=fold_weights,
            unknown=unknown,
            served_share=taken.served_share,
            contribution=taken.contribution,
            log_evidence=taken.score.log_evidence,
            included=taken.weighed.included,
            p_value=taken.score.p_value,
            confounded_with=confounded,
            conditional=float((lost / self._first).mean()),
        )

    def rejected(
        self,
        alone: Sequence[Score],
        last: Sequence[Score],
        taken: Sequence[Taken],
        named: Sequence[Named],
    ) -> tuple[RejectedEffect, ...]:
        """The effects that were not named, those first that explain most alone.

        Args:
            alone: scores of all effects while nothing was named.
            last: scores beside the named ones. Costly effects that failed alone have none.
            taken: the named ones.
            named: the same, as they are reported.
        """
        worth_alone = {score.name: float(score.worth.mean()) for score in alone}
        confounded = {name for each in named for name in each.confounded_with}
        names = {each.name for each in named}
        found = [
            RejectedEffect(name=name, form="", alone=0.0, left=0.0, p_value=1.0, reason=reason)
            for name, reason in self._scoring.out_of_scope.items()
        ]
        latest = {score.name: score for score in (*alone, *last)}
        found += [
            RejectedEffect(
                name=name,
                form=score.form.candidate.form,
                alone=worth_alone.get(name, 0.0),
                left=float(score.worth.mean()),
                p_value=score.p_value,
                log_evidence=score.log_evidence,
                reason=self._reason(score, taken, confounded),
            )
            for name, score in latest.items()
            if name not in names
        ]
        return tuple(sorted(found, key=lambda other: -other.alone))

    def _reason(self, score: Score, taken: Sequence[Taken], confounded: set[str]) -> str:
        """Why an effect was not named."""
        if score.name in confounded:
            return "cannot be told apart from an effect that was named and is likelier"
        if score.log_evidence <= 0:
            return "the residual is no likelier with it"
        least = self._scoring.constants.least_t(score.folds, score.chance)
        if score.t < least:
            return AS_USUAL if score.t_with_usual >= least else _how_it_fails(score)
        if self._scoring.contradicts(score, taken):
            return "its weights differ more than its cause allows"
        if stands(score, bool(taken), self._scoring.constants):
            further = self._scoring.raises_single_rows(score, taken)
            return "single rows are further off with it" if further else DOUBTED
        if not score.effect.is_predictable and is_worth_calibrating(score, self._scoring.constants):
            return AS_USUAL
        if score.worth.mean() <= 0.0:
            return "held-out blocks are further off with it"
        if score.worth.mean() >= self._scoring.constants.least_share:
            return "not sure enough for how little it takes off the error"
        return "takes too little off the error to matter"


def _how_it_fails(score: Score) -> str:
    """Why held-out folds do not confirm what all of them together may show."""
    by_fold = (score.gain + score.usual)[:, score.weighed.changes].sum(axis=1)
    worse = int((by_fold < 0).sum())
    how = f"{worse} of {score.folds} are further off with it" if worse else "few of them show most of it"
    return f"does not repeat over the held-out folds: {how}"

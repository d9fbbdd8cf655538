"""Selection: causes are compared on one scale of evidence, and each must prove itself on held-out blocks.

Evidence says what it is. In each step, every form of every effect is weighed beside the named ones. The
evidence of an effect is the mean over its forms, so that choosing among them has its price. A test over
held-out folds says whether anything is there. Both are computed with and without a constant of each
channel, since a trained model has absorbed the mean of what it lacks.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from taxel.channels import CHANNELS
from taxel.held_out_residual import HeldOutResidual
from taxel_models.loop.attribution import AS_USUAL, Attribution, Named, in_order
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.effects.effect import Effect
from taxel_models.loop.findings import RejectedEffect
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.forms import prepared_as_it_is
from taxel_models.loop.inference.parameter_correlation import parameter_correlation
from taxel_models.loop.inference.proof import simplest, stands
from taxel_models.loop.inference.score import Score, Taken, t_over_folds
from taxel_models.loop.inference.scoring import REFITS, Scoring
from taxel_models.loop.observations import Observations
from taxel_models.loop.status import StatusCallback, silent


class JointSelection:
    """One attribution.

    Args:
        observations: the recordings with the model's predictions.
        blocks: the fit part and the evaluation part. The selection does not use the evaluation part.
        effects: that compete.
        reference: the model's own held-out residual; None if it is not known.
        constants: of the inference.
        progress: is told which effect is weighed.
    """

    def __init__(
        self,
        observations: Observations,
        blocks: Blocks,
        effects: Sequence[Effect],
        *,
        reference: HeldOutResidual | None = None,
        constants: Constants = DECLARED,
        progress: StatusCallback = silent,
    ) -> None:
        self._first, self._blocks, self._constants = observations, blocks, constants
        self._progress = progress
        self._scoring = Scoring(observations, blocks, effects, reference, constants, progress)
        self._taken: list[Taken] = []
        self._tried: set[tuple[str, str]] = set()

    def run(self) -> Attribution:
        """Names effects until no other one proves itself."""
        # The products have few columns: threads cost more time than they save.
        with threadpool_limits(1):
            return self._run()

    def _run(self) -> Attribution:
        alone = self._scoring.scores(self._taken)
        scores = self._name(alone)
        before = [taken.name for taken in self._taken]
        named = self._exchange(alone)
        if {one.name for one in named} != set(before):
            scores = self._scoring.scores(self._taken)
        left = self._scoring.residual(self._taken)
        rejected = self._rejected(scores, alone, named)
        correlation = parameter_correlation(self._taken, self._scoring.base(self._taken).noise)
        return Attribution(self._scoring.observations, named, rejected, left, correlation)

    def _name(self, scores: list[Score]) -> list[Score]:
        """Names effects until no other one proves itself; the scores of those that are left."""
        while True:
            chosen = self.choose(scores)
            if chosen is None and not self._taken:
                chosen = self.proven_by_limits(scores)
            if chosen is None:
                return scores
            self._take(chosen)
            self._drop()
            scores = self._scoring.scores(self._taken)

    def proves_itself(self, score: Score, own: Score | None = None) -> bool:
        """Whether it stands on held-out folds, is worth naming, and its weights do not contradict it.

        Args:
            own: that was named already, and is compared with others in its place.
        """
        if score is not own and (score.name, score.form.candidate.form) in self._tried:
            return False
        if score.form.candidate.certain:
            return True
        if score.log_evidence <= 0:
            return False
        if not score.weighed.changes.any():
            return False
        if not stands(score, bool(self._taken), self._constants):
            return False
        return not self._scoring.contradicts(score, self._taken)

    def _casts_doubt(self, other: Score, best: Score) -> bool:
        """Whether a likelier effect, about as simple, does not repeat: the best may only stand for it.

        One that takes nothing off the error of held-out folds is no better explanation.
        """
        if best.form.candidate.fitting.few_channels:
            # Others take correlated channels for independent witnesses.
            return False
        likelier = other is not best and other.log_evidence > best.log_evidence
        simple = self._constants.simpler * other.freedom <= best.freedom
        tried = (other.name, other.form.candidate.form) in self._tried
        # What the model's own residual has, too, is no doubt about another cause.
        repeats = other.t_with_usual >= self._constants.least_t(other.folds)
        return likelier and simple and not tried and not repeats and bool(other.worth.mean() > 0)

    def choose(self, scores: Sequence[Score], own: Score | None = None) -> Score | None:
        """The likeliest effect that proves itself, or a simpler one that carries most of it.

        Where it is in doubt, a constant of each channel may still prove itself.
        """
        able = [score for score in scores if self.proves_itself(score, own)]
        certain = [score for score in able if score.form.candidate.certain]
        if certain or not able:
            return certain[0] if certain else None
        best = able[0]
        constant = next((score for score in able if score.effect.is_constant), None)
        if best.effect.is_constant:
            # All others stand beside a constant and are likelier than it is alone, but for changes of few
            # channels. Their gain is on another scale, so that it does not say which of the two is simpler.
            return best
        if any(self._casts_doubt(score, best) for score in scores):
            return constant
        if not best.effect.is_predictable:
            # Offsets of contacts contain whatever is steady within them.
            return next((score for score in able if score.effect.is_steady), best)
        if constant and best.needs_constant and 2 * constant.log_evidence > best.log_evidence:
            # More than half of what is found is the constant's, unless fewer figures tell it, too.
            fewer = best.freedom <= self._constants.simpler * constant.freedom
            if not fewer or best.log_evidence_alone <= constant.log_evidence:
                return constant
        if best.form.candidate.fitting.few_channels:
            # It has few figures already, and its gain is not on the scale of the others.
            return best
        # A constant is judged by itself, and all others beside one.
        others = [score for score in able if not score.effect.is_constant]
        # Where the best has a form as simple and likelier, it is as simple itself.
        simpler = [
            score
            for score in others
            if score.evidence_within(score.freedom) > best.evidence_within(score.freedom)
        ]
        return simplest(best, simpler, self._constants)

    def proven_by_limits(self, scores: Sequence[Score]) -> Score | None:
        """The likeliest effect, if predictions prove it only within the limits of counts."""
        score = scores[0] if scores else None
        if score is None or not score.effect.is_predictable:
            return None
        least = self._constants.least_t(score.folds)
        if score.t_with_usual >= least:
            return None
        if score.form.candidate.fitting.fixed or score.form.candidate.fitting.few_channels:
            return None
        free, within = self._scoring.by_predictions(score, self._taken)
        return within if free.t < least and self.proves_itself(within) else None

    def _take(self, score: Score) -> None:
        score = self._scoring.refined(score, self._taken)
        self._tried.add((score.name, score.form.candidate.form))
        candidate = score.form.candidate
        zeros = np.zeros_like(self._scoring.observations.residual)
        weights = np.ones((len(CHANNELS), score.form.size))
        taken = Taken(score, score.form, weights, zeros)
        if candidate.moved is not None:
            taken = replace(taken, contribution=self._scoring.move_inputs(candidate.moved))
            self._taken = [self._again(each) for each in self._taken]
        if score.effect.is_constant:
            # It was weighed by what channels show of it. What it foretells beyond their limits is no error.
            found = self._scoring.weights(taken, self._taken)
            taken = replace(self._again(taken), weights=found, contribution=candidate.basis.times(found))
        self._taken.append(taken)
        self._scoring.settle_limits(self._taken)
        self._refit()

    def _again(self, taken: Taken) -> Taken:
        """The same form for other predictions."""
        if taken.form.candidate.again is None:
            return taken
        candidate = taken.form.candidate.again(self._scoring.observations)
        return replace(taken, form=prepared_as_it_is(candidate, self._scoring.whitening))

    def _refit(self) -> None:
        """Weights of all named effects: each given the others, for some rounds."""
        for _ in range(REFITS):
            for place, taken in enumerate(self._taken):
                if taken.form.candidate.moves:
                    continue
                others = [each for each in self._taken if each is not taken]
                weights = self._scoring.weights(taken, others)
                contribution = taken.form.candidate.basis.times(weights)
                self._taken[place] = replace(taken, weights=weights, contribution=contribution)
            self._scoring.settle_limits(self._taken)

    def _drop(self) -> None:
        """Takes out named effects that explain too little beside the others, the weakest first."""
        while len(self._taken) > 1:
            weakest: tuple[float, Taken] | None = None
            for taken in self._taken[:-1]:
                candidate = taken.form.candidate
                if candidate.moves or candidate.certain or not taken.effect.is_predictable:
                    continue
                others = [each for each in self._taken if each is not taken]
                weighed, tested, shares = self._scoring.beside(taken, others)
                t = t_over_folds(tested.gain, taken.weighed)
                gain = float(tested.gain[:, taken.weighed.changes].sum())
                little = shares.mean() < self._constants.least_share / 2
                little &= shares.max() < self._constants.least_channel_share / 2
                little |= t < self._constants.least_t(len(tested.gain)) / 2
                if (weighed.log_evidence <= 0 or little) and (weakest is None or gain < weakest[0]):
                    weakest = gain, taken
            if weakest is None:
                return
            self._taken = [each for each in self._taken if each is not weakest[1]]
            self._refit()

    def _exchange(self, alone: Sequence[Score]) -> tuple[Named, ...]:
        """Replaces a named effect by a likelier or simpler one in its place; says which others could be."""
        replaced: set[str] = set()
        place, either = 0, {}
        while place < len(self._taken):
            taken = self._taken[place]
            candidate = taken.form.candidate
            self._progress(f"what could replace {taken.name}")
            if candidate.moves or candidate.certain or not taken.effect.is_predictable:
                either[taken.name] = self._alike(taken.score, alone) if candidate.moves else ()
                place += 1
                continue
            others = [each for each in self._taken if each is not taken]
            # Where only this effect leads beyond a limit, others must not be judged by what it says there.
            self._scoring.settle_limits(others)
            scores = self._scoring.scores(others)
            own = next((score for score in scores if score.name == taken.name), None)
            chosen = self.choose(scores, own)
            if chosen is not None and self._replaces(chosen, own) and taken.name not in replaced:
                replaced.add(taken.name)
                # Beside the other one, it may still have a part of its own.
                self._tried.discard((taken.name, candidate.form))
                self._taken = others
                self._take(chosen)
                self._drop()
                # What the other effect explained beside this one may have a name of its own.
                self._name(self._scoring.scores(self._taken))
                place, either = 0, {}
                continue
            self._scoring.settle_limits(self._taken)
            either[taken.name] = () if own is None else self._alike(own, scores)
            place += 1
        shares = self._fit_to_rows()
        shown = [
            taken for taken in self._taken if taken.contribution.any() or not taken.effect.is_predictable
        ]
        if len(shown) < len(self._taken):
            # Means of several rows show it, or a channel beside all others, and single rows do not.
            self._taken = shown
            self._refit()
            shares = self._fit_to_rows()
        return in_order(
            [
                self._finished(taken, either.get(taken.name, ()), share)
                for taken, share in zip(self._taken, shares, strict=True)
            ]
        )

    def _fit_to_rows(self) -> list[Floats]:
        """(21,) of each named effect's contribution, the share that single rows are best served with.

        Weights are inferred from means of several rows. A driver that is noisy from row to row, such as a
        force's rate, would bring its noise into every prediction.
        """
        fit, shares = self._blocks.fit, []
        left = self._scoring.residual(self._taken)[fit]
        for place, taken in enumerate(self._taken):
            candidate, own = taken.form.candidate, taken.contribution[fit]
            share = np.ones(len(CHANNELS))
            if not (candidate.moves or candidate.fitting.fixed) and taken.effect.is_predictable:
                products = np.array([((left + own) * own).sum(axis=0), (own**2).sum(axis=0)])
                if candidate.fitting.pooled:
                    products = (products / self._scoring.whitening.scale**2).sum(axis=1, keepdims=True)
                share *= np.clip(products[0] / np.maximum(products[1], 1e-12), 0.0, 1.0)
                share[~own.any(axis=0)] = 1.0
                left = left + own * (1.0 - share)
                self._taken[place] = replace(taken, contribution=taken.contribution * share)
            shares.append(share)
        return shares

    def _replaces(self, chosen: Score, own: Score | None) -> bool:
        """Whether another effect takes the place of a named one: a likelier one, or the simpler of two."""
        if own is None or chosen.name == own.name or not chosen.effect.is_predictable:
            return False
        if chosen.form.candidate.moves:
            return False
        is_simpler = chosen.freedom < own.freedom and not chosen.effect.is_constant
        return chosen.log_evidence > own.log_evidence or (is_simpler and self.proves_itself(own, own))

    def _alike(self, own: Score, scores: Sequence[Score]) -> tuple[str, ...]:
        """Effects that explain nearly as much on held-out folds, and are nearly as likely.

        Where the noise is small, any slow cause explains most of another one, and is far less likely.
        """
        names = {each.name for each in self._taken}
        return tuple(
            other.name
            for other in scores
            if other.name not in names
            and other.effect.is_predictable
            and other.most_gain >= self._constants.alike * own.total_gain > 0
            and other.log_evidence >= self._constants.alike * own.log_evidence
        )

    def _finished(self, taken: Taken, either: tuple[str, ...], share: Floats) -> Named:
        others = [each for each in self._taken if each is not taken]
        fit = self._blocks.fit
        first = np.maximum((self._first.residual[fit] ** 2).mean(axis=0), 1e-9)
        now = self._scoring.residual(self._taken)[fit]
        lost = ((now + taken.contribution[fit]) ** 2).mean(axis=0) - (now**2).mean(axis=0)
        # An interval around a shrunk weight would miss the true one.
        plain, beside = taken.without_prior, [each.without_prior for each in others]
        fixed = taken.form.candidate.fitting.fixed
        fold_weights = np.empty(0) if fixed else self._scoring.fold_weights(plain, beside)
        counts = taken.effect.is_constant and taken.form.candidate.weight_units == ("counts",)
        unknown = self._scoring.unknown_mean()[:, None] if counts else np.zeros_like(taken.weights)
        return Named(
            candidate=taken.form.candidate,
            equation=taken.effect.equation,
            weights=taken.weights,
            fold_weights=fold_weights,
            unknown=unknown,
            served_share=share,
            contribution=taken.contribution,
            log_evidence=taken.score.log_evidence,
            included=taken.weighed.included,
            p_value=taken.score.p_value,
            confounded_with=either,
            conditional=float((lost / first).mean()),
        )

    def _rejected(
        self, scores: Sequence[Score], alone: Sequence[Score], named: Sequence[Named]
    ) -> tuple[RejectedEffect, ...]:
        first = {score.name: float(score.worth.mean()) for score in alone}
        names = {each.name for each in named}
        confounded = {name for each in named for name in each.confounded_with}
        found = [
            RejectedEffect(name=name, form="", alone=0.0, left=0.0, p_value=1.0, reason=reason)
            for name, reason in self._scoring.out_of_scope.items()
        ]
        # Costly effects that failed by themselves were not weighed again.
        last = {score.name: score for score in (*alone, *scores)}
        for score in last.values():
            if score.name in names:
                continue
            if score.name in confounded:
                reason = "cannot be told apart from an effect that was named and is likelier"
            elif score.log_evidence <= 0:
                reason = "the residual is no likelier with it"
            elif score.t < (least := self._constants.least_t(score.folds, score.chance)):
                usual = score.t_with_usual >= least
                reason = AS_USUAL if usual else "does not repeat over the held-out folds"
            elif self._scoring.contradicts(score, self._taken):
                reason = "its weights differ more than its cause allows"
            else:
                reason = "too little to matter"
            found.append(
                RejectedEffect(
                    name=score.name,
                    form=score.form.candidate.form,
                    left=float(score.worth.mean()),
                    alone=first.get(score.name, 0.0),
                    log_evidence=score.log_evidence,
                    p_value=score.p_value,
                    reason=reason,
                )
            )
        return tuple(sorted(found, key=lambda other: -other.alone))

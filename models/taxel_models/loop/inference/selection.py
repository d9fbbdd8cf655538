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
from taxel_models.loop.attribution import Attribution
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.effects.effect import Effect
from taxel_models.loop.inference.choice import choose
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.forms import prepared_as_it_is
from taxel_models.loop.inference.outcome import Outcome
from taxel_models.loop.inference.parameter_correlation import parameter_correlation
from taxel_models.loop.inference.proof import stands
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
        self._constants, self._progress = constants, progress
        self._scoring = Scoring(observations, blocks, effects, reference, constants, progress)
        self._outcome = Outcome(observations, blocks, self._scoring)
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
        before = {taken.name for taken in self._taken}
        confounded = self._exchange(alone)
        self._fit_to_rows()
        named = self._outcome.named(self._taken, confounded)
        if {one.name for one in named} != before:
            scores = self._scoring.scores(self._taken)
        rejected = self._outcome.rejected(alone, scores, self._taken, named)
        left = self._scoring.residual(self._taken)
        correlation = parameter_correlation(self._taken, self._scoring.base(self._taken).noise)
        return Attribution(self._scoring.observations, named, rejected, left, correlation)

    def _name(self, scores: list[Score]) -> list[Score]:
        """Names effects until no other one proves itself; the scores of those that are left."""
        while (chosen := self._next(scores)) is not None:
            self._take(chosen)
            self._drop()
            scores = self._scoring.scores(self._taken)
        return scores

    def _next(self, scores: Sequence[Score]) -> Score | None:
        """The effect to be named next; where nothing proves itself, predictions may prove the first one."""
        chosen = self._chosen(scores)
        return self.proven_by_limits(scores) if chosen is None and not self._taken else chosen

    def _chosen(self, scores: Sequence[Score], own: Score | None = None) -> Score | None:
        able = [score for score in scores if self.proves_itself(score, own)]
        untried = [score for score in scores if not self._is_tried(score)]
        return choose(able, untried, self._constants)

    def _is_tried(self, score: Score) -> bool:
        """Whether the same form of the effect was named before, and may have been taken out again."""
        return (score.name, score.form.candidate.form) in self._tried

    def proves_itself(self, score: Score, own: Score | None = None) -> bool:
        """Whether it stands on held-out folds, is worth naming, and its weights do not contradict it.

        Args:
            own: that was named already, and is compared with others in its place.
        """
        if score is not own and self._is_tried(score):
            return False
        if score.form.candidate.certain:
            return True
        return (
            score.log_evidence > 0
            and bool(score.weighed.changes.any())
            and stands(score, bool(self._taken), self._constants)
            and not self._scoring.contradicts(score, self._taken)
            and not self._scoring.raises_single_rows(score, self._taken)
        )

    def proven_by_limits(self, scores: Sequence[Score]) -> Score | None:
        """The likeliest effect, if predictions prove it only within the limits of counts."""
        if not scores or not scores[0].effect.is_predictable:
            return None
        score = scores[0]
        least, fitting = self._constants.least_t(score.folds), score.form.candidate.fitting
        if score.t_with_usual >= least or fitting.fixed or fitting.few_channels:
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
                weights = self._scoring.weights(taken, self._but(taken))
                contribution = taken.form.candidate.basis.times(weights)
                self._taken[place] = replace(taken, weights=weights, contribution=contribution)
            self._scoring.settle_limits(self._taken)

    def _but(self, taken: Taken) -> list[Taken]:
        """The other named effects."""
        return [each for each in self._taken if each is not taken]

    def _drop(self) -> None:
        """Takes out named effects that explain too little beside the others, the weakest first."""
        while True:
            # The last one was just named.
            gains = [(self._gain_if_weak(taken), taken) for taken in self._taken[:-1]]
            weak = [(gain, taken) for gain, taken in gains if gain is not None]
            if not weak:
                return
            self._taken = self._but(min(weak, key=lambda one: one[0])[1])
            self._refit()

    def _gain_if_weak(self, taken: Taken) -> float | None:
        """What a named effect takes off beside the others, if that is too little to stay; else None.

        Half of what an effect needs to be named is enough.
        """
        if taken.stays:
            return None
        weighed, tested, shares = self._scoring.beside(taken, self._but(taken))
        t, least = t_over_folds(tested.gain, taken.weighed), self._constants.least_t(len(tested.gain))
        little = shares.mean() < self._constants.least_share / 2
        little &= shares.max() < self._constants.least_channel_share / 2
        weak = weighed.log_evidence <= 0 or little or t < least / 2
        return float(tested.gain[:, taken.weighed.changes].sum()) if weak else None

    def _exchange(self, alone: Sequence[Score]) -> dict[str, tuple[str, ...]]:
        """Replaces a named effect by a likelier or simpler one in its place; says which others could be.

        After each exchange, all named effects are compared anew.
        """
        replaced: set[str] = set()
        confounded: dict[str, tuple[str, ...]] = {}
        while taken := next((each for each in self._taken if each.name not in confounded), None):
            self._progress(f"what could replace {taken.name}")
            if taken.stays:
                moves = taken.form.candidate.moves
                confounded[taken.name] = self._alike(taken.score, alone) if moves else ()
                continue
            others = self._but(taken)
            # Where only this effect leads beyond a limit, others must not be judged by what it says there.
            self._scoring.settle_limits(others)
            scores = self._scoring.scores(others)
            own = next((score for score in scores if score.name == taken.name), None)
            chosen = self._chosen(scores, own)
            if chosen and self._replaces(chosen, own) and taken.name not in replaced:
                replaced.add(taken.name)
                self._replace(taken, chosen)
                confounded.clear()
                continue
            self._scoring.settle_limits(self._taken)
            confounded[taken.name] = self._alike(own, scores) if own else ()
        return confounded

    def _replace(self, taken: Taken, chosen: Score) -> None:
        """Names another effect in the place of one, and whatever that leaves."""
        # Beside the other one, it may still have a part of its own.
        self._tried.discard((taken.name, taken.form.candidate.form))
        self._taken = self._but(taken)
        self._take(chosen)
        self._drop()
        # What the other effect explained beside this one may have a name of its own.
        self._name(self._scoring.scores(self._taken))

    def _fit_to_rows(self) -> None:
        """Scales contributions to what single rows show, and takes out effects of which they show nothing.

        Means of several rows may show those, or a channel beside all others.
        """
        self._taken = self._outcome.fitted_to_rows(self._taken)
        shown = [
            taken for taken in self._taken if taken.contribution.any() or not taken.effect.is_predictable
        ]
        if len(shown) < len(self._taken):
            self._taken = shown
            self._refit()
            self._taken = self._outcome.fitted_to_rows(self._taken)

    def _replaces(self, chosen: Score, own: Score | None) -> bool:
        """Whether another effect takes the place of a named one: a likelier one, or the simpler of two."""
        if own is None or chosen.name == own.name or not chosen.effect.is_predictable:
            return False
        if chosen.form.candidate.moves:
            return False
        if own.effect.is_constant and chosen.needs_constant:
            # It does not say what the constant says.
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

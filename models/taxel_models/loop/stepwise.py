"""Stepwise selection: effects compete for the residual, and each step names one of them.

A step cross-validates every form of every effect on the remaining residual. It names the best effect if
that explains more than chance lets any candidate explain, and if it explains enough. Then all named effects
are fitted again. The steps end when no effect passes. To find what chance explains, the signs of whole
blocks are drawn at random.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from threadpoolctl import threadpool_limits

from taxel_models.loop.attribution import Attribution, Named, rejected
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks, thinned
from taxel_models.loop.cross_validation import (
    Score,
    absolute_of,
    cross_validate,
    random_signs,
    row_weights_of,
    scale_of,
    stands_out,
    worth,
)
from taxel_models.loop.effects.effect import Candidate, Effect, Remaining
from taxel_models.loop.model_selection import (
    FOLD_LEVEL,
    LEAST_CHANNEL_SHARE,
    LEAST_SHARE,
    LEVEL,
    contends,
    could_replace,
    likeliest,
    more_specific,
    simplest,
    steadiest,
    worth_most,
)
from taxel_models.loop.observations import Observations
from taxel_models.loop.statistics import SufficientStatistics

DRAWS: Final = 199
MOST_ROWS: Final = 24_000
"""The most rows that are fitted: neighbouring rows tell nearly the same."""

CERTAIN_CHANNEL_SHARE: Final = 0.01
"""The least share of one channel's error that names a certain fault, which chance cannot cause."""

MOST_EFFECTS: Final = 8
REFITS: Final = 3
Progress = Callable[[str], None]


class StepwiseSelection:
    """One attribution.

    Args:
        observations: the recordings with the model's predictions.
        blocks: the fit part and the evaluation part. The selection does not use the evaluation part.
        effects: the effects that compete.
        seed: the seed of the blocks' random signs.
        least_share: the share of the error that an effect must remove to be named, over all channels. One
            channel is enough if the effect removes this share of its error, and `LEAST_CHANNEL_SHARE`.
        progress: is told which effect is tried.
    """

    def __init__(
        self,
        observations: Observations,
        blocks: Blocks,
        effects: Sequence[Effect],
        *,
        seed: int,
        least_share: float = LEAST_SHARE,
        progress: Progress | None = None,
    ) -> None:
        self._observations = observations
        self._first = observations
        self._blocks = thinned(blocks, MOST_ROWS)
        self._effects = effects
        self._progress = progress or _silent
        self._least_share = least_share
        self._signs = random_signs(DRAWS, int((blocks.fold >= 0).sum()), seed)
        self._scale = scale_of(observations.residual[blocks.fit])
        self._row_weights = row_weights_of(observations.residual, observations.pressed, blocks.fit)
        self._absolute = absolute_of(observations.residual, blocks.fit)
        self._named: list[Named] = []
        self._alone: list[Score] = []
        """The scores on the first residual, before an effect was named."""
        self._tried: set[tuple[str, str]] = set()
        """Forms that were named before. No form is named twice, so the selection ends."""
        self._forms: dict[str, tuple[Candidate, ...]] = {}
        """The forms of effects that do not depend on the residual, for the present observations."""

    def run(self) -> Attribution:
        """Names effects until chance explains the residual as well as any candidate."""
        # The products have few columns: threads cost more time than they save.
        with threadpool_limits(1):
            return self._run()

    def _run(self) -> Attribution:
        while True:
            scores = self.scores(self._left())
            self._alone = self._alone or scores
            p_values = self._p_values(scores)
            chosen = self.best(scores, p_values)
            if chosen is None or len(self._named) == MOST_EFFECTS:
                break
            self._name(chosen, p_values[chosen.candidate.effect])
            self._refit()
            self._drop_superfluous()
        self._confound()
        others = rejected(scores, p_values, self._named, self._alone, self._scale)
        return Attribution(self._observations, tuple(self._named), others, self._left())

    def _left(self, without: Named | None = None) -> Floats:
        """(n, 21) the residual without the named effects; `without` is not taken out."""
        left = self._observations.residual
        for named in self._named:
            if not named.score.candidate.moves:
                left = left - named.contribution
        return left if without is None else left + without.contribution

    def scores(self, residual: Floats) -> list[Score]:
        """The best form of each effect on a residual."""
        found = []
        left = Remaining(residual, self._blocks.fit, self._row_weights)
        for effect in self._effects:
            self._progress(effect.label)
            forms = [self._score(candidate, residual) for candidate in self._forms_of(effect, left)]
            if not forms:
                continue
            best = simplest(forms)
            finer = [
                self._score(candidate, residual)
                for candidate in effect.finer(self._observations, best.candidate)
            ]
            found.append(simplest([best, *finer]) if finer else steadiest(forms))
        return found

    def _forms_of(self, effect: Effect, left: Remaining) -> Sequence[Candidate]:
        if effect.looks_at_residual:
            return tuple(effect.forms(self._observations, left))
        if effect.label not in self._forms:
            self._forms[effect.label] = tuple(effect.forms(self._observations, left))
        return self._forms[effect.label]

    def _score(self, candidate: Candidate, residual: Floats) -> Score:
        statistics = SufficientStatistics.of(
            candidate.basis, residual, self._row_weights, self._blocks, candidate.fitting
        )
        return cross_validate(candidate, statistics, self._scale)

    def _p_values(self, scores: Sequence[Score]) -> dict[str, float]:
        """For each effect, how often chance lets any candidate stand out as much."""
        found = np.stack([stands_out(score.statistics, self._scale, self._signs) for score in scores])
        most = found[:, 1:].max(axis=0)
        return {
            score.candidate.effect: float((1 + (most >= found[place, 0]).sum()) / (1 + len(most)))
            for place, score in enumerate(scores)
        }

    def best(self, scores: Sequence[Score], p_values: dict[str, float]) -> Score | None:
        """The effect to name, or None.

        1. A candidate must stand out from chance, have plausible weights, and be worth enough. A certain
           candidate that is worth enough is named at once.
        2. At least one candidate must stand out at `LEVEL` and repeat over the folds. This decides that
           there is an effect at all.
        3. Of the candidates that are worth nearly the most, the one that explains most on held-out blocks
           is named, or a simpler one that explains as much. The p-values do not decide here: the better
           explanation may have the larger p-value.
        4. An effect of few channels goes first if it explains far more in them.
        """
        moved = {named.name for named in self._named if named.score.candidate.moves}
        able: list[tuple[float, Score]] = []
        clear: list[tuple[Score, Floats]] = []
        for score in scores:
            p_value, candidate = p_values[score.candidate.effect], score.candidate
            tried = (candidate.effect, candidate.form) in self._tried
            if tried or candidate.effect in moved or score.contradicts(self._scale):
                continue
            if not (candidate.certain or contends(score, p_value)):
                continue
            worths = self._worth(score)
            total, most = float(worths.mean()), float(worths.max())
            least = max(LEAST_CHANNEL_SHARE, self._least_share)
            enough = CERTAIN_CHANNEL_SHARE if candidate.certain else least
            if total >= self._least_share or (most >= enough and total > 0):
                if candidate.certain:
                    return score
                able.append((total, score))
                if p_value <= LEVEL and score.repeats <= FOLD_LEVEL:
                    clear.append((score, worths))
        if not clear:
            return None
        return more_specific(likeliest(worth_most(able), self._scale), clear)

    def _worth(self, score: Score) -> Floats:
        """(21,) the share of each channel's first error that it removes in cross-validation."""
        candidate = score.candidate
        alike = SufficientStatistics.of(
            candidate.basis, self._left(), self._absolute, self._blocks, candidate.fitting
        )
        basis_rows = candidate.basis.rows
        first = self._first.residual**2 * self._absolute[:, None]
        kept = self._blocks.fit
        rows = np.flatnonzero(kept) if basis_rows is None else basis_rows[kept[basis_rows]]
        return worth(score, alike, self._scale, first[rows].sum(axis=0))

    def _name(self, chosen: Score, p_value: float) -> None:
        effect = next(effect for effect in self._effects if effect.label == chosen.candidate.effect)
        self._tried.add((chosen.candidate.effect, chosen.candidate.form))
        weights = chosen.statistics.weights(self._scale)
        if chosen.candidate.moved is None:
            contribution = chosen.candidate.basis.times(weights)
        else:
            # The predictions change, and so do all forms.
            before, self._observations = self._observations, chosen.candidate.moved(self._observations)
            contribution = self._observations.predicted - before.predicted
            self._forms.clear()
        named = Named(effect, chosen, weights, contribution, p_value)
        self._named = [other for other in self._named if other.name != named.name] + [named]

    def _refit(self) -> None:
        """Fits all named effects again, each to the residual of the others, for some rounds."""
        for _ in range(REFITS if len(self._named) > 1 else 1):
            for place, named in enumerate(self._named):
                self._named[place] = self._fitted_again(named)

    def _fitted_again(self, named: Named) -> Named:
        candidate = named.score.candidate
        if candidate.again is None:
            return named
        refitted = self._score(candidate.again(self._observations), self._left(without=named))
        weights = refitted.statistics.weights(self._scale)
        contribution = refitted.candidate.basis.times(weights)
        return replace(named, score=refitted, weights=weights, contribution=contribution)

    def _drop_superfluous(self) -> None:
        """Removes named effects that explain too little beside the others."""
        while len(self._named) > 1:
            conditional = [self._conditional(named) for named in self._named]
            weakest = int(np.argmin([share for share, _ in conditional]))
            share, most = conditional[weakest]
            if share >= self._least_share / 2 or most >= LEAST_CHANNEL_SHARE / 2:
                break
            if self._named[weakest].score.candidate.moves:
                break
            self._named.pop(weakest)
            self._refit()

    def _conditional(self, named: Named) -> tuple[float, float]:
        """The share of the energy that is lost without it: the mean over channels, and the largest."""
        fit = self._blocks.fit
        first = self._first.residual[fit]
        energy = np.maximum((first**2).mean(axis=0), 1e-9)
        gain = (self._left(without=named)[fit] ** 2).mean(axis=0) - (self._left()[fit] ** 2).mean(axis=0)
        return float((gain / energy).mean()), float((gain / energy).max())

    def _confound(self) -> None:
        """Finds the effects that could replace each named effect."""
        names = {named.name for named in self._named}
        for place, named in enumerate(self._named):
            self._progress(f"what could replace {named.name}")
            # Forms that move the inputs are relative to the inputs before.
            moves = named.score.candidate.moves
            scores = self._alone if moves else self.scores(self._left(without=named))
            own = next((other for other in scores if other.candidate.effect == named.name), None)
            able = tuple(
                other.candidate.effect
                for other in scores
                if own is not None and other.candidate.effect not in names and could_replace(own, other)
            )
            conditional = self._conditional(named)[0]
            self._named[place] = replace(named, confounded_with=able, conditional=conditional)


def _silent(note: str) -> None:
    del note

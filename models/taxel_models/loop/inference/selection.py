"""Selection: causes are compared on one scale of evidence, and each must prove itself on held-out blocks.

Evidence says what it is. In each step, every form of every effect is weighed beside the named ones. The
evidence of an effect is the mean over its forms, so that choosing among them has its price. A test over
held-out folds says whether anything is there. Both are computed with and without a constant of each channel,
since a trained model has absorbed the mean of what it lacks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from taxel.channels import CHANNELS, COUNTS_MAX, ELECTRODE_COLUMNS
from taxel.manifest import HeldOutResidual
from taxel_models.evaluation.standard_error import corrected_standard_error
from taxel_models.loop.attribution import Attribution, Named, Rejected
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.effects.effect import Effect, Fitting, Remaining
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.inference import contact_offset
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.evidence import (
    Base,
    Design,
    HeldOut,
    Products,
    Weighed,
    held_out,
    posterior_weights,
    weigh,
)
from taxel_models.loop.inference.forms import Form, prepared
from taxel_models.loop.inference.whitening import Bins, NoiseShape, Whitening
from taxel_models.loop.observations import Observations

Progress = Callable[[str], None]
_REFITS = 3


@dataclass(frozen=True)
class Score:
    """What one effect explains beside the named ones.

    Attributes:
        effect: which; None for offsets of each contact.
        form: its likeliest.
        weighed: that form, in the likelier of the two bases.
        log_evidence: of all its forms together.
        needs_constant: whether its likeliest form stands beside a constant of each channel.
        worth: (21,) share of each channel's held-out error that goes.
        t: over held-out folds, beside a constant of each channel.
        gain: fall of the held-out squared error, over the noise.
    """

    effect: Effect | None
    form: Form
    weighed: Weighed
    log_evidence: float
    needs_constant: bool
    worth: Floats
    t: float
    gain: float

    @property
    def name(self) -> str:
        """The effect's."""
        return self.form.candidate.effect

    @property
    def freedom(self) -> int:
        """How many figures it fits."""
        return self.form.freedom(int(self.weighed.changes.sum()))


@dataclass(frozen=True)
class _Taken:
    """A named effect while others are looked for."""

    effect: Effect | None
    form: Form
    weighed: Weighed
    first: Score
    weights: Floats
    contribution: Floats

    @property
    def name(self) -> str:
        return self.form.candidate.effect

    @property
    def is_regressor(self) -> bool:
        """Whether its weights are inferred together with those of others."""
        fitting = self.form.candidate.fitting
        return not (fitting.fixed or fitting.pooled)


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
        progress: Progress | None = None,
    ) -> None:
        self._observations = self._first = observations
        self._blocks, self._constants = blocks, constants
        scope = {effect.label: effect.out_of_scope(observations) for effect in effects}
        self._out_of_scope = {name: reason for name, reason in scope.items() if reason is not None}
        self._effects = [effect for effect in effects if effect.label not in self._out_of_scope]
        self._progress = progress or _silent
        self._reference = reference
        self._beyond: Floats | float = 0.0
        """(n, 21) how far the named effects lead beyond the counts' limits where a channel stands at one."""
        self._bins = Bins.of(blocks, constants.bin_s)
        shape = NoiseShape.usual()
        if reference is not None:
            shape = NoiseShape(np.array(reference.shared), np.array(reference.fading))
        self._whitening = Whitening(self._bins, shape, observations.residual, constants)
        self._row_weights = self._whitening.row_weights(len(observations))
        ones = np.broadcast_to(self._whitening.scale[:, None, None], (len(CHANNELS), len(self._bins), 1))
        self._ones = Design(self._whitening(ones), self._bins.fold)
        target = self._base([]).target.values[:, :, 0]
        self._energy = np.maximum((target**2).sum(axis=1), 1e-9)
        self._forms: dict[str, list[Form]] = {}
        self._taken: list[_Taken] = []
        self._tried: set[tuple[str, str]] = set()

    def run(self) -> Attribution:
        """Names effects until no other one proves itself."""
        # The products have few columns: threads cost more time than they save.
        with threadpool_limits(1):
            return self._run()

    def _run(self) -> Attribution:
        alone: list[Score] = []
        while True:
            scores = self.scores(self._taken)
            alone = alone or scores
            chosen = self.choose(scores)
            if chosen is None or len(self._taken) == self._constants.most_effects:
                break
            self._take(chosen)
            self._drop()
        named = self._exchange(alone)
        left = self._residual(self._taken)
        return Attribution(self._observations, named, self._rejected(scores, alone, named), left)

    # What is weighed

    def _residual(self, taken: Sequence[_Taken]) -> Floats:
        """(n, 21) what some effects leave, counts."""
        left = self._observations.residual + self._beyond
        for each in taken:
            if not each.form.candidate.moves:
                left = left - each.contribution
        return left

    def _base(self, taken: Sequence[_Taken]) -> Base:
        regressors = [each for each in taken if each.is_regressor]
        apart = self._residual([each for each in taken if not each.is_regressor])
        target = Design(self._whitening(self._bins.means(apart.T[:, :, None])), self._bins.fold)
        values = [np.empty((len(CHANNELS), len(self._bins), 0))]
        precision = [np.empty((len(CHANNELS), 0))]
        for each in regressors:
            values.append(each.form.design.values)
            own = np.where(each.weighed.changes, each.weighed.strength**-2, np.inf)
            precision.append(np.repeat(own[:, None], each.form.size, axis=1))
        design = Design(np.concatenate(values, axis=2), self._bins.fold)
        return Base(target, design, np.concatenate(precision, axis=1), self._whitening.quantum)

    def _forms_of(self, effect: Effect, left: Floats) -> list[Form]:
        if effect.looks_at_residual or effect.label not in self._forms:
            remaining = Remaining(left, self._blocks.fit, self._row_weights.mean(axis=1))
            self._forms[effect.label] = [
                form
                for candidate in effect.forms(self._observations, remaining)
                for form in prepared(candidate, self._whitening)
            ]
        return self._forms[effect.label]

    def scores(self, taken: Sequence[_Taken]) -> list[Score]:
        """Every other effect beside some named ones, the likeliest first."""
        base, left = self._base(taken), self._residual(taken)
        beside = base.with_constant(self._ones)
        constant = weigh(Products.of(base, self._ones), Fitting(), self._constants).log_evidence
        names = {each.name for each in taken}
        found = []
        for effect in self._effects:
            if effect.label in names:
                continue
            self._progress(effect.label)
            forms = self._forms_of(effect, left)
            if forms:
                found.append(self._score(effect, forms, base, beside, constant))
        contact = None if contact_offset.NAME in names else self._contact_offset(base, left)
        found += [] if contact is None else [contact]
        return sorted(found, key=lambda score: -score.log_evidence)

    def _score(
        self, effect: Effect, forms: Sequence[Form], base: Base, beside: Base, constant: float
    ) -> Score:
        is_constant = effect.name == Offset.name
        found: list[Score] = []
        logs = []
        for form in forms:
            fitting = form.candidate.fitting
            plain = weigh(Products.of(base, form.design), fitting, self._constants)
            options = [(plain.log_evidence, plain, False)]
            test = Products.of(base if is_constant else beside, form.design)
            if not is_constant:
                second = weigh(test, fitting, self._constants)
                options.append((second.log_evidence + constant, second, True))
            logs.append(float(logsumexp([option[0] for option in options]) - np.log(len(options))))
            value, weighed, needs = max(options, key=lambda option: option[0])
            tested = held_out(test, fitting, weighed)
            found.append(self._scored(effect, form, weighed, value, tested, needs_constant=needs))
        best = max(found, key=lambda score: score.log_evidence)
        total = float(logsumexp(logs) - np.log(len(logs))) - self._usual(effect.label, tested)[0]
        return replace(self._simplest(best, found), log_evidence=total)

    def _simplest(self, best: Score, scores: Sequence[Score]) -> Score:
        """The likeliest of those simpler than the best that carry most of what it explains, or the best."""
        simpler = [
            score
            for score in scores
            if score.effect is not None
            and score.freedom <= self._constants.simpler * best.freedom
            and score.gain >= self._constants.carries * best.gain > 0
        ]
        return max(simpler, key=lambda score: score.log_evidence, default=best)

    def _scored(
        self,
        effect: Effect | None,
        form: Form,
        weighed: Weighed,
        log_evidence: float,
        tested: HeldOut,
        *,
        needs_constant: bool = False,
        energy: Floats | None = None,
    ) -> Score:
        """A score less what the effect explains of the model's own held-out residual."""
        evidence, gain = self._usual(form.candidate.effect, tested)
        gain = tested.gain - gain
        worth = (gain * tested.noise).sum(axis=0) / (self._energy if energy is None else energy)
        log_evidence -= evidence
        t, total = _over_folds(gain, weighed)
        return Score(effect, form, weighed, log_evidence, needs_constant, worth, t, total)

    def _usual(self, name: str, tested: HeldOut) -> tuple[float, Floats]:
        """The log evidence and the gain (folds, 21) that an effect has on the model's own residual."""
        if self._reference is None or name not in self._reference.structure:
            return 0.0, np.zeros_like(tested.gain)
        known = self._reference.structure
        _, bins = np.unique(self._bins.fold, return_counts=True)
        relative = np.array(known[name].gain) / (tested.noise * self._whitening.scale**2)
        # Where other effects make the residual larger, the model's own structure is a smaller part of it.
        part = np.mean(np.minimum(1.0, (np.array(self._reference.std) / self._whitening.scale) ** 2))
        return known[name].log_evidence * len(self._bins) * float(part), bins[:, None] * relative

    def structure(self) -> dict[str, tuple[float, Floats]]:
        """For each effect alone, its log evidence and its gain (21,), counts², for each bin."""
        with threadpool_limits(1):
            scores = self.scores([])
        energy = self._energy * self._whitening.scale**2 / len(self._bins)
        return {
            score.name: (
                max(0.0, score.log_evidence / len(self._bins)),
                np.maximum(score.worth, 0.0) * energy,
            )
            for score in scores
        }

    def _contact_offset(self, base: Base, left: Floats) -> Score | None:
        """Offsets of each contact, if the model's own held-out residual says how much is usual."""
        segment = self._observations.segment
        if self._reference is None:
            return None
        if contact_offset.contacts(segment[self._blocks.fit]) < contact_offset.FEWEST:
            return None
        taken = {
            seconds: contact_offset.calibrated(
                self._observations, self._blocks, left, self._row_weights, seconds
            )
            for seconds in contact_offset.CALIBRATIONS_S
        }
        last = taken[contact_offset.CALIBRATIONS_S[-1]]
        white = self._whitening(self._bins.means(left.T[:, :, None]))[:, :, 0]
        log_evidence = contact_offset.log_evidence(
            white, self._ones.values[:, :, 0], self._bins.blocks, self._constants.strengths
        )
        removed = {
            seconds: float((each.gain.sum(axis=0) / np.maximum(each.before.sum(axis=0), 1e-9)).mean())
            for seconds, each in taken.items()
        }
        candidate = contact_offset.candidate_of(last.offsets * last.shares, removed)
        (form,) = prepared(candidate, self._whitening)
        weighed = Weighed(log_evidence, 1.0, np.ones(len(CHANNELS)))
        # Sums over rows in counts² become sums over bins in units of the noise.
        noise = base.noise
        unit = noise * self._whitening.scale**2 * self._bins.rows_each
        tested = HeldOut(last.gain / unit, last.before / unit, noise)
        energy = np.maximum((tested.before * noise).sum(axis=0), 1e-9)
        return self._scored(None, form, weighed, log_evidence, tested, energy=energy)

    # What is named

    def proves_itself(self, score: Score) -> bool:
        """Whether it stands on held-out folds, is worth naming, and its weights do not contradict it."""
        constants = self._constants
        if score.log_evidence <= 0 or (score.name, score.form.candidate.form) in self._tried:
            return False
        changes = score.weighed.changes
        if not changes.any():
            return False
        enough = score.worth.mean() >= constants.least_share
        if score.effect is None:
            # No model can foretell them, so they must explain more to be named.
            enough = score.worth.mean() >= constants.least_channel_share
        else:
            enough |= score.worth[changes].max() >= constants.least_channel_share
        if score.form.candidate.certain:
            return True
        return bool(enough and score.t >= constants.least_t) and not self._contradicts(score)

    def _contradicts(self, score: Score) -> bool:
        """Whether electrodes' weights differ more than their common cause allows."""
        alike = score.form.candidate.alike
        if alike is None:
            return False
        _, scaled = posterior_weights(
            Products.of(self._base(self._taken), score.form.design),
            score.form.candidate.fitting,
            score.weighed,
        )
        weights = score.form.weights(scaled)[ELECTRODE_COLUMNS]
        mean = weights.mean(axis=0)
        deviation = np.sqrt(((weights - mean) ** 2).sum(axis=1).mean())
        return bool(deviation > alike * max(float(np.linalg.norm(mean)), 1e-12))

    def choose(self, scores: Sequence[Score]) -> Score | None:
        """The likeliest effect that proves itself, or a simpler one that carries most of what it explains."""
        able = [score for score in scores if self.proves_itself(score)]
        certain = [score for score in able if score.form.candidate.certain]
        if certain or not able:
            return certain[0] if certain else None
        best = able[0]
        offset = next((score for score in able if score.name == Offset.name), None)
        if offset is not None and best.needs_constant and 2 * offset.log_evidence > best.log_evidence:
            return offset
        # A constant is judged by itself, and all others beside one.
        return self._simplest(best, [score for score in able if score.name != Offset.name])

    def _refined(self, score: Score) -> Score:
        """The likeliest of the forms around an effect's likeliest one, if its forms are points of a grid."""
        base = self._base(self._taken)
        beside = base.with_constant(self._ones)
        constant = weigh(Products.of(base, self._ones), Fitting(), self._constants).log_evidence
        for _ in range(_REFITS):
            if score.effect is None:
                break
            finer = [
                form
                for candidate in score.effect.finer(self._observations, score.form.candidate)
                for form in prepared(candidate, self._whitening)
            ]
            if not finer:
                break
            found = self._score(score.effect, [score.form, *finer], base, beside, constant)
            found = replace(found, log_evidence=score.log_evidence)
            if found.form is score.form:
                break
            score = found
        return score

    def _take(self, score: Score) -> None:
        score = self._refined(score)
        self._tried.add((score.name, score.form.candidate.form))
        candidate = score.form.candidate
        zeros = np.zeros_like(self._observations.residual)
        weights = np.ones((len(CHANNELS), score.form.size))
        taken = _Taken(score.effect, score.form, score.weighed, score, weights, zeros)
        if candidate.moved is not None:
            # The predictions change, and so do all forms.
            before, self._observations = self._observations, candidate.moved(self._observations)
            taken = replace(taken, contribution=self._observations.predicted - before.predicted)
            self._forms.clear()
            self._taken = [self._again(each) for each in self._taken]
        self._taken.append(taken)
        self._refit()

    def _again(self, taken: _Taken) -> _Taken:
        """The same form for other predictions."""
        if taken.form.candidate.again is None:
            return taken
        candidate = taken.form.candidate.again(self._observations)
        form = next(iter(prepared(replace(candidate, mean_absorbed=False), self._whitening)))
        return replace(taken, form=form)

    def _refit(self) -> None:
        """Weights of all named effects: each given the others, for some rounds."""
        for _ in range(_REFITS):
            for place, taken in enumerate(self._taken):
                if taken.form.candidate.moves:
                    continue
                others = [each for each in self._taken if each is not taken]
                weights = self._weights(taken, others)
                contribution = taken.form.candidate.basis.times(weights)
                self._taken[place] = replace(taken, weights=weights, contribution=contribution)
            self._beyond = self._beyond_limits()

    def _beyond_limits(self) -> Floats:
        predicted = self._observations.predicted + sum(
            each.contribution for each in self._taken if not each.form.candidate.moves
        )
        measured = self._observations.measured
        below = np.where(measured <= 0, np.minimum(predicted, 0.0), 0.0)
        above = np.where(measured >= COUNTS_MAX, np.maximum(predicted - COUNTS_MAX, 0.0), 0.0)
        return np.asarray(below + above)

    def _weights(self, taken: _Taken, others: Sequence[_Taken], fold: int | None = None) -> Floats:
        products = Products.of(self._base(others), taken.form.design)
        kept = None if fold is None else np.arange(products.folds) != fold
        _, scaled = posterior_weights(products, taken.form.candidate.fitting, taken.weighed, kept)
        return taken.form.weights(scaled)

    def _beside(self, taken: _Taken, others: Sequence[_Taken]) -> tuple[Weighed, HeldOut]:
        """A named effect's own form, weighed and tested beside the others."""
        products = Products.of(self._base(others), taken.form.design)
        fitting = taken.form.candidate.fitting
        weighed = weigh(products, fitting, self._constants)
        return weighed, held_out(products, fitting, taken.weighed)

    def _drop(self) -> None:
        """Takes out named effects that explain too little beside the others, the weakest first."""
        while len(self._taken) > 1:
            weakest: tuple[float, _Taken] | None = None
            for taken in self._taken[:-1]:
                candidate = taken.form.candidate
                if candidate.moves or candidate.certain or taken.effect is None:
                    continue
                others = [each for each in self._taken if each is not taken]
                weighed, tested = self._beside(taken, others)
                t, gain = _over_folds(tested.gain, taken.weighed)
                shares = tested.shares
                little = shares.mean() < self._constants.least_share / 2
                little &= shares.max() < self._constants.least_channel_share / 2
                if (weighed.log_evidence <= 0 or little or t < self._constants.least_t / 2) and (
                    weakest is None or gain < weakest[0]
                ):
                    weakest = gain, taken
            if weakest is None:
                return
            self._taken = [each for each in self._taken if each is not weakest[1]]
            self._refit()

    def _exchange(self, alone: Sequence[Score]) -> tuple[Named, ...]:
        """Replaces a named effect by one that is likelier in its place; says which others could be."""
        replaced: set[str] = set()
        place, either = 0, {}
        while place < len(self._taken):
            taken = self._taken[place]
            candidate = taken.form.candidate
            self._progress(f"what could replace {taken.name}")
            if candidate.moves or candidate.certain or taken.effect is None:
                either[taken.name] = self._alike(taken.first, alone) if candidate.moves else ()
                place += 1
                continue
            others = [each for each in self._taken if each is not taken]
            scores = self.scores(others)
            own = next((score for score in scores if score.name == taken.name), None)
            chosen = self.choose(scores)
            if chosen is not None and self._replaces(chosen, own) and taken.name not in replaced:
                replaced.add(taken.name)
                self._taken = others
                self._take(chosen)
                self._drop()
                place, either = 0, {}
                continue
            either[taken.name] = () if own is None else self._alike(own, scores)
            place += 1
        return tuple(self._finished(taken, either.get(taken.name, ())) for taken in self._taken)

    @staticmethod
    def _replaces(chosen: Score, own: Score | None) -> bool:
        """Whether another effect takes the place of a named one."""
        if own is None or chosen.name == own.name or chosen.effect is None:
            return False
        return chosen.log_evidence > own.log_evidence and not chosen.form.candidate.moves

    def _alike(self, own: Score, scores: Sequence[Score]) -> tuple[str, ...]:
        """Effects that explain nearly as much on held-out folds."""
        names = {each.name for each in self._taken}
        return tuple(
            other.name
            for other in scores
            if other.name not in names
            and other.effect is not None
            and own.gain > 0
            and other.gain >= self._constants.either * own.gain
        )

    def _finished(self, taken: _Taken, either: tuple[str, ...]) -> Named:
        others = [each for each in self._taken if each is not taken]
        fit = self._blocks.fit
        first = np.maximum((self._first.residual[fit] ** 2).mean(axis=0), 1e-9)
        now = self._residual(self._taken)[fit]
        lost = ((now + taken.contribution[fit]) ** 2).mean(axis=0) - (now**2).mean(axis=0)
        fixed = taken.form.candidate.fitting.fixed
        folds = 0 if fixed else int(self._bins.fold.max()) + 1
        fold_weights = [self._weights(taken, others, fold) for fold in range(folds)]
        return Named(
            candidate=taken.form.candidate,
            equation=_EQUATION if taken.effect is None else taken.effect.equation,
            weights=taken.weights,
            fold_weights=np.array(fold_weights),
            contribution=taken.contribution,
            log_evidence=taken.first.log_evidence,
            included=taken.weighed.included,
            t=taken.first.t,
            confounded_with=either,
            conditional=float((lost / first).mean()),
        )

    def _rejected(
        self, scores: Sequence[Score], alone: Sequence[Score], named: Sequence[Named]
    ) -> tuple[Rejected, ...]:
        first = {score.name: float(score.worth.mean()) for score in alone}
        confounded = {name for each in named for name in each.confounded_with}
        found = [
            Rejected(name, "", 0.0, 0.0, 0.0, 0.0, reason) for name, reason in self._out_of_scope.items()
        ]
        for score in scores:
            if score.name in {each.name for each in named}:
                continue
            if score.name in confounded:
                reason = "cannot be told apart from an effect that was named and is likelier"
            elif score.log_evidence <= 0:
                reason = "the residual is no likelier with it"
            elif score.t < self._constants.least_t:
                reason = "does not repeat over the held-out folds"
            elif self._contradicts(score):
                reason = "its weights differ more than its cause allows"
            else:
                reason = "too little to matter"
            worth = float(score.worth.mean())
            form = score.form.candidate.form
            found.append(
                Rejected(
                    score.name, form, worth, first.get(score.name, 0.0), score.log_evidence, score.t, reason
                )
            )
        return tuple(sorted(found, key=lambda other: -other.alone))


_EQUATION = "delta_c = b_c,contact"


def _over_folds(gain: Floats, weighed: Weighed) -> tuple[float, float]:
    """The larger t of two tests over the folds, and the gain in all, over the channels that change.

    The first test counts all these channels alike. The second weighs them by what the other folds show,
    since the noise of the other channels would hide an effect of a few. Under chance, a fold's gain is as
    likely below 0 as above, since it has no influence on its own weights.

    Args:
        gain: (folds, 21).
    """
    some = gain[:, weighed.changes]
    by_fold = some.sum(axis=1)
    others = np.maximum((some.sum(axis=0) - some) / max(len(some) - 1, 1), 0.0)
    weighted = (others * some).sum(axis=1) / np.maximum(others.sum(axis=1), 1e-12)
    return max(_t(by_fold), _t(weighted)), float(by_fold.sum())


def _t(by_fold: Floats) -> float:
    """Of the corrected resampled t-test: each fold is tested on one part and fitted to the others."""
    error = corrected_standard_error(by_fold, 1.0 / max(len(by_fold) - 1, 1))
    return float(by_fold.mean()) / max(error, 1e-12)


def _silent(note: str) -> None:
    del note

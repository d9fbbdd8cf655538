"""Scores: what each effect explains beside those that are named already."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel.held_out_residual import HeldOutResidual
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.effects.effect import Effect, Remaining
from taxel_models.loop.effects.offset import Offset
from taxel_models.loop.inference.all_channels import AllChannels
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.contact_offset import SCATTER_UNKNOWN, ContactOffset, ContactOffsets
from taxel_models.loop.inference.correlated_channels import CorrelatedChannels
from taxel_models.loop.inference.evidence import Bases, HeldOut, Weighed, held_out, posterior_weights, weigh
from taxel_models.loop.inference.few_channels_form import FewChannelsForm
from taxel_models.loop.inference.few_channels_search import FewChannelsSearch
from taxel_models.loop.inference.forms import WhitenedForm, prepared, prepared_as_it_is
from taxel_models.loop.inference.named_in_channels import NamedInChannels
from taxel_models.loop.inference.products import Base, Design, Products
from taxel_models.loop.inference.proof import stands
from taxel_models.loop.inference.score import Score, Taken
from taxel_models.loop.inference.usual import Usual
from taxel_models.loop.inference.weighing import Weighing
from taxel_models.loop.inference.whitening import Bins, NoiseShape, Whitening
from taxel_models.loop.inference.worth import held_out_error
from taxel_models.loop.observations import FEWEST_CONTACTS, Observations
from taxel_models.loop.status import StatusCallback

REFITS: Final = 3
"""Rounds in which weights, or a form's parameters, are found again."""


class Scoring:
    """Weighs and tests effects on the fit part.

    Args:
        observations: the recordings with the model's predictions.
        blocks: the fit part and the evaluation part. The evaluation part is not used.
        effects: that compete.
        reference: the model's own held-out residual; None if it is not known.
        constants: of the inference.
        progress: is told which effect is weighed.

    Attributes:
        out_of_scope: effects that these observations cannot show, with the reason.
        bins: of the fit part.
        constants: of the inference.
    """

    def __init__(
        self,
        observations: Observations,
        blocks: Blocks,
        effects: Sequence[Effect],
        reference: HeldOutResidual | None,
        constants: Constants,
        progress: StatusCallback,
    ) -> None:
        self.observations = observations
        self._blocks, self.constants = blocks, constants
        scope = {effect.label: effect.out_of_scope(observations) for effect in effects}
        self.out_of_scope = {name: reason for name, reason in scope.items() if reason is not None}
        self._effects = [effect for effect in effects if effect.label not in self.out_of_scope]
        self._progress = progress
        self._reference = reference
        self._beyond: Floats | float = 0.0
        """(n, 21) how far the named effects lead beyond the limits of counts where a channel is at one."""
        self.bins = Bins.of(blocks, constants.bin_s)
        shape = NoiseShape.usual() if reference is None else NoiseShape.kept(reference)
        self.whitening = Whitening(self.bins, shape, observations.residual, constants)
        self._usual = Usual(reference, self.bins.fold, self.whitening.scale)
        if not self._usual.knows(ContactOffset.name):
            self.out_of_scope[ContactOffset.name] = SCATTER_UNKNOWN
        self._correlated: CorrelatedChannels | None = None
        if reference is not None and reference.correlated is not None:
            known = reference.correlated
            self._correlated = CorrelatedChannels(observations.residual, self.bins, known, constants)
        self._mean_row_weights = self.whitening.row_weights(len(observations)).mean(axis=1)
        self._contacts = ContactOffsets(observations, blocks, self.whitening, constants.strengths)
        self._ones = Design(self.whitening.ones, self.bins.fold)
        self._prediction_noise = self._noise_of_prediction()
        errors = self.whitening.coloured(self.base([]).target.values[:, :, 0])
        self._weighing = Weighing(self._usual, self.whitening, errors, constants)
        self._forms: dict[str, list[WhitenedForm]] = {}
        self._hopeless: dict[str, int] = {}
        """Effects with costly forms that the residual did not speak for: 0 alone, 1 beside others."""

    def move_inputs(self, moved: Callable[[Observations], Observations]) -> Floats:
        """Change the inputs, and so all predictions and forms; (n, 21) the predictions' change, counts."""
        before, self.observations = self.observations, moved(self.observations)
        self._forms.clear()
        self._prediction_noise = self._noise_of_prediction()
        return self.observations.predicted - before.predicted

    def _noise_of_prediction(self) -> Design:
        """What the prediction of each channel changes within a second, as large as its residual.

        A model brings noise of its own into its prediction, and its residual has the same noise with the
        other sign. It is fast. Whatever is in proportion to the prediction would be found too small, since
        the noise of neighbouring bins counts much where the residual fades slowly.
        """
        means = self.bins.means(self.observations.predicted.T[:, :, None])
        fast = self.bins.fast(means, self.constants.fading_s)
        size = np.sqrt((fast**2).mean(axis=1, keepdims=True))
        fast *= self.whitening.scale[:, None, None] / np.where(size > 1e-9, size, np.inf)
        return Design(self.whitening(fast), self.bins.fold)

    def residual(self, taken: Sequence[Taken]) -> Floats:
        """(n, 21) what some effects leave, counts."""
        left = self.observations.residual + self._beyond
        for each in taken:
            if not each.form.candidate.moves:
                left = left - each.contribution
        return left

    def base(self, taken: Sequence[Taken]) -> Base:
        """The residual with the regressors of some named effects."""
        regressors = [each for each in taken if each.is_regressor]
        apart = self.residual([each for each in taken if not each.is_regressor])
        target = Design(self.whitening(self.bins.means(apart.T[:, :, None])), self.bins.fold)
        values = [self._prediction_noise.values]
        precision = [np.ones((len(CHANNELS), 1))]
        for each in regressors:
            values.append(each.form.design.values)
            own = np.where(each.weighed.changes, each.weighed.strength**-2, np.inf)
            precision.append(np.repeat(own[:, None], each.form.size, axis=1))
        design = Design(np.concatenate(values, axis=2), self.bins.fold)
        return Base(target, design, np.concatenate(precision, axis=1), self.whitening.quantum, not_served=1)

    def bases(self, taken: Sequence[Taken]) -> Bases:
        """The base, the same beside a constant of each channel, and the constant's own evidence."""
        return Bases.of(self.base(taken), self._constant(self.residual(taken)), self.constants)

    def _constant(self, left: Floats) -> Design:
        """The regressor of a constant of each channel, as large as its residual, where channels show it."""
        measured, rows = self.observations.measured, self.bins.order
        share = self.observations.limits.share_of_constants(measured[rows], (measured - left)[rows])
        if (share == 1.0).all():
            return self._ones
        shown = np.ones_like(left)
        shown[rows] = share
        means = self.bins.means(shown.T[:, :, None]) * self.whitening.scale[:, None, None]
        return Design(self.whitening(means), self.bins.fold)

    def _remaining(self, left: Floats, taken: Sequence[Taken]) -> Remaining:
        waves = () if self._reference is None else self._reference.waves
        beside = [each.form.candidate.basis for each in taken if each.is_regressor]
        return Remaining(left, self._blocks.fit, self._mean_row_weights, waves, beside)

    def _forms_of(self, effect: Effect, left: Floats, taken: Sequence[Taken]) -> list[WhitenedForm]:
        if effect.looks_at_residual or effect.label not in self._forms:
            remaining = self._remaining(left, taken)
            self._forms[effect.label] = [
                form
                for candidate in effect.forms(self.observations, remaining)
                for form in prepared(candidate, self.whitening)
            ]
        forms = self._forms[effect.label]
        if effect.is_constant:
            constant, *calibrated = forms
            return [replace(constant, design=self._constant(left)), *calibrated]
        return forms

    def forms_of(self, effect: Effect) -> list[WhitenedForm]:
        """The forms of an effect while nothing is named."""
        return self._forms_of(effect, self.residual([]), [])

    def scores(self, taken: Sequence[Taken]) -> list[Score]:
        """Every other effect beside some named ones, the likeliest first."""
        left = self.residual(taken)
        bases = self.bases(taken)
        names = {each.name for each in taken}
        found = []
        beside = min(len(taken), 1)
        for effect in self._effects:
            # What a first effect leaves may speak for one that the whole residual hid.
            if effect.label in names or self._hopeless.get(effect.label, -1) >= beside:
                continue
            self._progress(effect.label)
            forms = self._forms_of(effect, left, taken)
            if forms:
                score = self._weighing.likeliest(effect, forms, bases, beside_others=bool(taken))
                found.append(score)
                weak = score.log_evidence <= 0 or score.t < self.constants.least_t(score.folds)
                if effect.is_costly and (weak or score.worth.mean() < self.constants.least_share):
                    self._hopeless[effect.label] = beside
        if self._correlated is not None:
            named, remaining = self._beside(self._correlated, taken), self._remaining(left, taken)
            together = AllChannels(
                self._correlated,
                [effect for effect in self._effects if effect.label not in names],
                lambda effect: [form.candidate for form in self._forms_of(effect, left, taken)],
                partial(FewChannelsSearch, self._correlated, self.observations, remaining, named),
                bases=named.bases(()),
                rivals=self._rivals(found, taken),
                beside_others=bool(taken),
            )
            found = [together.judged(score) for score in found]
        contact = None if ContactOffset.name in names else self._contact_offset(bases.plain, left)
        found += [] if contact is None else [contact]
        return sorted(found, key=lambda score: -score.log_evidence)

    def _rivals(self, scores: Sequence[Score], taken: Sequence[Taken]) -> set[str]:
        """The effects that may be likelier than a change of few channels.

        Beside a named effect whose form is not quite right, many are likely that do not repeat. Those will
        not be named, and so they explain nothing.
        """
        if all(each.form.candidate.certain for each in taken):
            return {score.name for score in scores}
        return {score.name for score in scores if stands(score, True, self.constants)}

    def unknown_mean(self) -> Floats:
        """(21,) the size of a constant that the model's own held-out residual leaves open, counts."""
        if self._reference is None or Offset.name not in self._reference.structure:
            return np.zeros(len(CHANNELS))
        gain = np.array(self._reference.structure[Offset.name].gain)
        return np.sqrt(gain / np.maximum(self.whitened_constant(np.ones(len(CHANNELS))), 1e-12))

    def whitened_constant(self, counts: Floats) -> Floats:
        """(21,) what a constant (21,), counts, adds to the whitened squared error of a bin, counts²."""
        size = (self._ones.values[:, :, 0] ** 2).mean(axis=1)
        return np.asarray(size * counts**2)

    def _contact_offset(self, base: Base, left: Floats) -> Score | None:
        """Offsets of each contact, if the model's own held-out residual says how much is usual."""
        if not self._usual.knows(ContactOffset.name) or self._contacts.count < FEWEST_CONTACTS:
            return None
        usual = self._usual.log_evidence(ContactOffset.name)
        form, weighed, tested = self._contacts.weighed(left, base.noise, usual)
        total = weighed.log_evidence
        return self._weighing.scored(ContactOffset(), form, weighed, total, tested, tested.shares)

    def raises_single_rows(self, score: Score, taken: Sequence[Taken]) -> bool:
        """Whether the squared error of single rows rises by an effect of which nothing is fitted.

        Evidence and folds judge means of several rows, and blocks by how disturbed they are. A part of a
        tick's delay may speak there for a whole tick, which is too much for single rows.
        """
        if not score.effect.fits_nothing:
            return False
        fit, form = self._blocks.fit, score.form
        left = self.residual(taken)[fit]
        change = form.candidate.basis.times(np.ones((len(CHANNELS), form.size)))[fit]
        falls = ((2.0 * left - change) * change).sum(axis=0) / np.maximum((left**2).sum(axis=0), 1e-9)
        return bool(falls.mean() <= 0.0)

    def contradicts(self, score: Score, taken: Sequence[Taken]) -> bool:
        """Whether electrodes' weights differ more than their common cause allows."""
        alike = score.form.candidate.alike
        if alike is None:
            return False
        _, scaled = posterior_weights(
            Products.of(self.base(taken), score.form.design),
            score.form.candidate.fitting,
            score.weighed,
        )
        weights = score.form.weights(scaled)[ELECTRODE_COLUMNS]
        mean = weights.mean(axis=0)
        deviation = np.sqrt(((weights - mean) ** 2).sum(axis=1).mean())
        return bool(deviation > alike * max(float(np.linalg.norm(mean)), 1e-12))

    def refined(self, score: Score, taken: Sequence[Taken]) -> Score:
        """The likeliest of the forms around an effect's likeliest one, or with what it may have beside it.

        Where single rows tell more than their means, they have the last word.
        """
        bases, fit = self.bases(taken), self._blocks.fit
        for _ in range(REFITS):
            finer = [
                form
                for candidate in score.effect.finer(self.observations, score.form.candidate, fit)
                for form in prepared(candidate, self.whitening)
            ]
            if not finer:
                break
            forms = [score.form, *finer]
            found = self._weighing.likeliest(
                score.effect, forms, bases, beside_others=bool(taken), named=True
            )
            found = replace(found, log_evidence=score.log_evidence)
            if found.form is score.form:
                break
            score = found
        best = score.form.candidate
        candidate = score.effect.by_rows(self.observations, best, self.residual(taken), fit)
        if candidate is best:
            return score
        return replace(score, form=prepared_as_it_is(candidate, self.whitening))

    def by_predictions(self, score: Score, taken: Sequence[Taken]) -> tuple[Score, Score]:
        """The same score by predictions of held-out folds: as they are, and within the limits of counts.

        A channel that is at its limit does not contradict an effect that leads beyond it, though no line
        through its rows can tell. Rows of a block count as if they were independent.
        """
        measured, predicted = self.observations.measured, self._predicted(taken)
        own = Taken(score, score.form, np.empty((0, 0)), np.empty((0, 0)))
        added = np.zeros_like(predicted)
        order = self.bins.order
        fold = np.repeat(self.bins.fold, self.bins.sizes)
        for number, weights in enumerate(self.fold_weights(own, taken)):
            rows = order[fold == number]
            added[rows] = score.form.candidate.basis.times(weights)[rows]
        row_weights = self.whitening.row_weights(len(measured)) / self.bins.rows_each
        noise = self.base(taken).noise * self.whitening.scale**2

        def tested(limited: Callable[[Floats], Floats]) -> Score:
            before, after = (
                row_weights * (measured - limited(counts)) ** 2 for counts in (predicted, predicted + added)
            )
            falls = (before - after)[order]
            gain = np.array([falls[fold == number].sum(axis=0) for number in range(len(score.gain))])
            gain = gain / noise - score.usual
            worth = gain.sum(axis=0) * noise / np.maximum(before[order].sum(axis=0), 1e-9)
            return replace(score, gain=gain, worth=worth)

        return tested(lambda counts: counts), tested(self.observations.limits.shown)

    def _predicted(self, taken: Sequence[Taken]) -> Floats:
        """(n, 21) counts with some named effects."""
        added = sum(each.contribution for each in taken if not each.form.candidate.moves)
        return np.asarray(self.observations.predicted + added)

    def settle_limits(self, taken: Sequence[Taken]) -> None:
        """A channel that is at a limit of the counts does not contradict effects that lead beyond it."""
        predicted, measured = self._predicted(taken), self.observations.measured
        self._beyond = self.observations.limits.beyond(measured, predicted)

    def weights(self, taken: Taken, others: Sequence[Taken]) -> Floats:
        """(21, k) weights of a named effect beside others, by the fit part."""
        return np.asarray(self._weights(taken, others, np.ones((1, self.bins.folds), np.bool_))[0])

    def fold_weights(self, taken: Taken, others: Sequence[Taken]) -> Floats:
        """(folds, 21, k) the same by all of the fit part but one fold."""
        return self._weights(taken, others, ~np.eye(self.bins.folds, dtype=np.bool_))

    def _weights(self, taken: Taken, others: Sequence[Taken], kept: NDArray[np.bool_]) -> Floats:
        """(choices, 21, k) by the folds that are kept in each choice (choices, folds)."""
        if self._correlated is not None and isinstance(taken.form, FewChannelsForm):
            beside = self._beside(self._correlated, others)
            return self._correlated.weights(taken.form, beside, taken.weighed.strength, kept)
        products = Products.of(self.base(others), taken.form.design)
        _, scaled = posterior_weights(products, taken.form.candidate.fitting, taken.weighed, kept)
        return np.array([taken.form.weights(each) for each in scaled])

    def _beside(self, correlated: CorrelatedChannels, others: Sequence[Taken]) -> NamedInChannels:
        """What changes of few channels are weighed beside where others are named."""
        # Those that have weights of each channel.
        named = [
            each
            for each in others
            if not (each.form.candidate.fitting.fixed or each.form.candidate.fitting.pooled)
        ]
        return correlated.beside_named(self.residual(others), named)

    def beside(self, taken: Taken, others: Sequence[Taken]) -> tuple[Weighed, HeldOut, Floats]:
        """A named effect's own form, weighed and tested beside the others; (21,) what share it removes."""
        if self._correlated is not None and isinstance(taken.form, FewChannelsForm):
            beside_others = self._beside(self._correlated, others)
            weighed, tested = self._correlated.tested(taken.form, beside_others)
            return weighed, tested, tested.shares
        products = Products.of(self.base(others), taken.form.design)
        fitting = taken.form.candidate.fitting
        before, after = held_out_error(products, fitting, taken.weighed, self.whitening.coloured)
        shares = (before - after) / np.maximum(before, 1e-12)
        weighed = weigh(products, fitting, self.constants)
        return weighed, held_out(products, fitting, taken.weighed), shares

"""Channels whose errors are correlated: a change of a few channels is judged beside what all others show.

Channels of a model err alike, since all of them answer to one contact that the inputs give inexactly. What
the others show so foretells most of a channel's error, and a change of that channel alone stands out from
the rest. All channels are fitted together here, by generalised least squares (Aitken 1936): whitened with
the root of the precision of the model's own held-out residual, their errors have no correlation left.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.held_out_residual import CorrelatedResidual
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.crosstalk import explained_beside_own
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Remaining
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.evidence import Bases, HeldOut, Weighed, held_out, posterior_weights, weigh
from taxel_models.loop.inference.few_channels_form import TOGETHER, ChannelForms, FewChannelsForm
from taxel_models.loop.inference.named_in_channels import NamedInChannels
from taxel_models.loop.inference.products import Base, Design, Products
from taxel_models.loop.inference.score import Taken
from taxel_models.loop.inference.whitening import ROUNDING, Bins, NoiseShape, Whitening
from taxel_models.loop.observations import Observations


class Signals(NamedTuple):
    """An effect's forms of each channel, with three kinds of signals.

    Attributes:
        about_mean: of signals about their mean, which the model has absorbed.
        about_rest: of the same signals about rest.
        predicted: of the model's prediction alone. What is measured of other channels holds their errors,
            which a channel seems to follow where these are larger than they were, such as in a wave that
            all of them have. A true leak or gain follows the predicted part of the signal as well.
    """

    about_mean: ChannelForms
    about_rest: ChannelForms
    predicted: ChannelForms


class OfMany(NamedTuple):
    """What all channels together show of an effect that changes many.

    Attributes:
        log_evidence: of its likeliest form, 0 at least.
        gain: fall of the squared error over the known noise on folds that nothing was fitted to, less what
            the model's own residual has of it.
    """

    log_evidence: float = 0.0
    gain: float = 0.0


class CorrelatedChannels:
    """Channels that are fitted together, on the fit part: their forms, and what these are weighed beside.

    Attributes:
        bins: of the fit part.
        constants: of the inference.

    Args:
        residual: (n, 21) of the recordings, counts.
        bins: of the fit part.
        known: of the model's own held-out residual.
        constants: of the inference.
        whiten: gives (n, 21) the errors over their noise, without correlation, of a residual (n, 21) in
            counts; None for the root of the known precision.
    """

    def __init__(
        self,
        residual: Floats,
        bins: Bins,
        known: CorrelatedResidual,
        constants: Constants,
        whiten: Callable[[Floats], Floats] | None = None,
    ) -> None:
        self.bins, self._known, self.constants = bins, known, constants
        self._precision = np.array(known.precision)
        self._root = root_of(self._precision)
        self._whiten = whiten or (lambda residual: residual @ self._root.T)
        shape = NoiseShape.kept(known)
        rounding = ROUNDING * np.sqrt((self._root**2).sum(axis=1))
        self._whitening = Whitening(bins, shape, self._whiten(residual), constants, rounding)
        self._ones = Design(self._whitening.ones, bins.fold)

    def knows(self, effect: str) -> bool:
        """Whether the model's own residual tells how much of an effect is usual."""
        return effect in self._known.structure

    def conditional_residual(self, residual: Floats) -> Floats:
        """(n, 21) of a residual, the part that the other channels do not foretell, about 0, counts."""
        around = residual - residual[self.bins.order].mean(axis=0)
        return np.asarray(self._whiten(around) @ self._root / np.diag(self._precision))

    def _bases_of(self, target: Floats) -> Bases:
        """What forms are weighed beside, of a whitened residual (21, bins, 1)."""
        none = np.empty((len(CHANNELS), 0))
        nothing = Design(none[:, None, :].repeat(len(self.bins), axis=1), self.bins.fold)
        # An error of 1 is what the model's own held-out residual has.
        noise = self._whitening.scale**-2
        base = Base(Design(target, self.bins.fold), nothing, none, self._whitening.quantum, noise)
        return Bases.of(base, self._ones, self.constants)

    def beside_named(self, left: Floats, named: Sequence[Taken]) -> NamedInChannels:
        """What changes of a few channels are weighed beside.

        Args:
            left: (n, 21) what named effects leave, counts.
            named: those that have weights of each channel.
        """
        forms = ChannelForms([one.form.candidate for one in named], self._root, self._whitening)
        target = self._whitening(self.bins.means(self._whiten(left).T[:, :, None]))
        changed = [one.weighed.changes for one in named]
        return NamedInChannels(changed, forms, target, self._bases_of)

    def weights(
        self,
        form: FewChannelsForm,
        beside: NamedInChannels,
        strength: float,
        kept: NDArray[np.bool_] | None = None,
    ) -> Floats:
        """(choices, 21, k) weights of a form by the folds that are kept in each choice (choices, folds).

        Without choices, there is one: all folds.
        """
        products = beside.products(form.design, form.channels)
        kept = np.ones((1, products.folds), np.bool_) if kept is None else kept
        every = Weighed(0.0, strength, np.ones(len(CHANNELS)), np.zeros(len(CHANNELS)))
        _, scaled = posterior_weights(products, TOGETHER, every, kept)
        return np.array([form.weights(each) for each in scaled])

    def tested(self, form: FewChannelsForm, beside: NamedInChannels) -> tuple[Weighed, HeldOut]:
        """A named form, weighed and tested beside others."""
        products = beside.products(form.design, form.channels)
        weighed = weigh(products, TOGETHER, self.constants)
        found = held_out(products, TOGETHER, weighed)
        gain = found.gain.sum(axis=1)[:, None] * form.included / form.included.sum()
        return weighed, HeldOut(gain, found.before, np.ones(len(CHANNELS)), found.squared_change)

    def of_many(self, label: str, forms: Sequence[Candidate], bases: Bases) -> OfMany:
        """The likeliest form of an effect that changes many channels.

        Nothing shows where no form is likely, and where the model's own residual does not tell how much of
        the effect is usual.
        """
        if not self.knows(label):
            return OfMany()
        known, odds = self._known.structure[label], self.usual_odds(label)
        reached, best = 0.0, None
        for candidate, (products, fitting) in zip(forms, self.products_of_many(forms, bases), strict=True):
            usual = odds if known.has(candidate.form_itself) else np.zeros_like(odds)
            weighed = weigh(products, fitting, self.constants, usual)
            if weighed.log_evidence > reached:
                reached, best = weighed.log_evidence, (products, fitting, weighed, usual)
        if best is None:
            return OfMany()
        products, fitting, weighed, usual = best
        found = held_out(products, fitting, weighed)
        # Odds are half of what goes of the squared error over the noise, but for the prior.
        gain = (found.gain * found.noise / bases.beside.counted_noise).sum() - 2.0 * usual.sum()
        return OfMany(reached, float(gain))

    def products_of_many(
        self, forms: Sequence[Candidate], bases: Bases
    ) -> Iterator[tuple[Products, Fitting]]:
        """Of forms that change many channels, as the whitened channels show them."""
        apart = replace(bases.beside, known_noise=None)
        for candidate in forms:
            fitting, means = candidate.fitting, self.bins.of_basis(candidate.basis)
            if len(means) > 1 and means.shape[2] == 1 and not (fitting.fixed or fitting.pooled):
                every = dict.fromkeys(range(len(CHANNELS)), 0)
                design = ChannelForms([candidate], self._root, self._whitening).design(every)
                yield Products.of(bases.beside, design), TOGETHER
            else:
                # Which channels a form may change says nothing of whitened ones.
                yield Products.of(apart, self._design(means, fitting)), replace(fitting, allowed=None)

    def _design(self, means: Floats, fitting: Fitting) -> Design:
        """The regressors (1 or 21, bins, k) of a form that changes many channels, whitened."""
        every = np.broadcast_to(means, (len(CHANNELS), *means.shape[1:]))
        if fitting.fixed or fitting.pooled:
            image = np.einsum("cd,dbk->cbk", self._root, every, optimize=True)
        elif len(means) == 1:
            # Weights of whitened channels are sums of the channels' own.
            image = every
        else:
            # Several weights of each channel are too many for all together: the others' part is left out.
            image = np.diag(self._root)[:, None, None] * every
        if not fitting.fixed:
            size = np.sqrt((image**2).mean(axis=1)) / self._whitening.scale[:, None]
            size = np.sqrt((size**2).mean(axis=0, keepdims=True)) if fitting.pooled else size
            image = image / np.where(size > 1e-9, size, np.inf)[:, None, :]
        return Design(self._whitening(image), self.bins.fold)

    def signals(self, effect: Effect, observations: Observations, remaining: Remaining) -> list[Signals]:
        """The forms of an effect that `follows` signals, of each channel, by kinds of signals.

        What the others foretell of a channel has their errors. Where these are not those of the held-out
        residual, a gain follows the prediction alone more closely.
        """
        own = self.conditional_residual(remaining.residual)
        # What the other channels and the model foretell has no part of the channel's own error.
        expected = observations.measured - own
        seen = observations.measured if effect.follows == "measured" else expected
        explained = partial(self._explained, remaining.residual)
        remaining = replace(remaining, residual=own, explained=explained)
        mean = seen[self.bins.order].mean(axis=0)
        about_mean = _of_each_channel(effect, observations.seen_as(seen, expected, mean), remaining)
        about_rest = _of_each_channel(effect, observations.seen_as(seen, expected, None), remaining)
        predicted = [one.again(observations) for one in about_mean if one.again is not None]
        forms = (
            ChannelForms(own, self._root, self._whitening) for own in (about_mean, about_rest, predicted)
        )
        signals = Signals(*forms)
        if effect.follows == "measured":
            return [signals]
        return [signals, Signals(signals.predicted, signals.predicted, signals.predicted)]

    def _explained(self, residual: Floats, signals: Floats, own: Floats) -> Floats:
        """(k, 21) how much of the squared error each signal (n, k) explains as a part of each channel.

        Args:
            residual: (n, 21) counts.
            own: (n, 21) of each channel, which stands beside the signal.
        """
        both = self._whitening(self.bins.means(np.hstack([signals, own])[None]))
        target = self._whitening(self.bins.means(self._whiten(residual).T[:, :, None]))[:, :, 0]
        ones = self._ones.values / np.sqrt((self._ones.values**2).sum(axis=1, keepdims=True))
        both -= ones * (ones * both).sum(axis=1, keepdims=True)
        # A part of a channel shows in each whitened one by the root; an error of 1 is usual there.
        shown = self._root * self._whitening.scale[:, None] ** 2
        gram = np.einsum("wc,wij->cij", shown * self._root, both.transpose(0, 2, 1) @ both, optimize=True)
        cross = np.einsum("wc,wbi,wb->ci", shown, both, target, optimize=True)
        count, channel = signals.shape[1], np.arange(len(CHANNELS))
        energy = gram.diagonal(axis1=1, axis2=2)
        return explained_beside_own(
            cross[:, :count].T,
            energy[:, :count].T,
            gram[channel, :count, count + channel].T,
            cross[channel, count + channel],
            energy[channel, count + channel],
        )

    def usual_odds(self, label: str) -> Floats:
        """(21,) log odds that the model's own residual gives an effect."""
        known = self._known.structure.get(label)
        return np.zeros(len(CHANNELS)) if known is None else len(self.bins) * np.array(known.log_evidence)

    def usual_gain(self, label: str) -> Floats:
        """(21,) gain of an effect in the model's own residual, over the noise, for each bin."""
        known = self._known.structure.get(label)
        return np.zeros(len(CHANNELS)) if known is None else np.array(known.gain)


def root_of(precision: Floats) -> Floats:
    """(21, 21) symmetric root of a precision, in units of each channel's size (Kessy et al. 2018)."""
    size = 1.0 / np.sqrt(np.diag(precision))
    values, vectors = np.linalg.eigh(precision * np.outer(size, size))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T / size)


def _of_each_channel(effect: Effect, seen: Observations, remaining: Remaining) -> list[Candidate]:
    """Forms with weights of each channel."""
    return [
        candidate
        for candidate in effect.forms(seen, remaining)
        if not (candidate.fitting.pooled or candidate.fitting.fixed)
    ]

"""Channels whose errors are correlated: a change of a few channels is judged beside what all others show.

Channels of a model err alike, since all of them answer to one contact that the inputs give inexactly. What
the others show so foretells most of a channel's error, and a change of that channel alone stands out from
the rest. All channels are fitted together here, by generalised least squares (Aitken 1936): whitened with
the root of the precision of the model's own held-out residual, their errors have no correlation left.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy import stats
from typing_extensions import override

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel.manifest import CorrelatedResidual, OwnStructure
from taxel_models.evaluation.standard_error import corrected_standard_error
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Candidate, Effect, Fitting, Remaining
from taxel_models.loop.inference.constants import Constants
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
from taxel_models.loop.inference.forms import WhitenedForm
from taxel_models.loop.inference.precision import root_of
from taxel_models.loop.inference.score import Score
from taxel_models.loop.inference.whitening import ROUNDING, Bins, NoiseShape, Whitening
from taxel_models.loop.observations import Observations

MOST_CHANNELS: Final = 5
"""Channels of one form. A cause that all channels have, such as a wave, shows in more of them: it is no
change of a few, though each channel follows its neighbours."""

TOGETHER: Final = Fitting(pooled=True)
"""A joint regressor changes all whitened channels by one weight."""


@dataclass(frozen=True)
class JointForm(WhitenedForm):
    """A form that changes some channels, as regressors of all whitened channels together.

    Attributes:
        places: of each joint regressor, its channel and its column.
        sizes: of each joint regressor, what makes a weight of 1 a change as large as the noise of a bin.
    """

    places: tuple[tuple[int, int], ...]
    sizes: Floats

    @property
    @override
    def freedom(self) -> int:
        return len(self.places)

    @property
    def channels(self) -> list[int]:
        """That it changes."""
        return sorted({channel for channel, _ in self.places})

    @property
    def included(self) -> Floats:
        """(21,) 1 for a channel that it changes."""
        return np.isin(np.arange(len(CHANNELS)), self.channels).astype(np.float64)

    @override
    def weights(self, scaled: Floats) -> Floats:
        found = np.zeros((len(CHANNELS), self.size))
        for (channel, column), value, size in zip(self.places, scaled[0], self.sizes, strict=True):
            found[channel, column] = value / size
        return found


class CorrelatedChannels:
    """Weighs and tests changes of a few channels on the fit part.

    Args:
        observations: the recordings with the model's predictions.
        bins: of the fit part.
        known: of the model's own held-out residual.
        constants: of the inference.
        whiten: gives (n, 21) the errors over their noise, without correlation, of a residual (n, 21) in
            counts; None for the root of the known precision.
    """

    def __init__(
        self,
        observations: Observations,
        bins: Bins,
        known: CorrelatedResidual,
        constants: Constants,
        whiten: Callable[[Floats], Floats] | None = None,
    ) -> None:
        self._observations, self._bins, self._constants = observations, bins, constants
        self._known = known
        self._precision = np.array(known.precision)
        self._root = root_of(self._precision)
        self._whiten = whiten or (lambda residual: residual @ self._root.T)
        shape = NoiseShape(np.array(known.shared), np.array(known.fading))
        rounding = ROUNDING * np.sqrt((self._root**2).sum(axis=1))
        errors = self._whiten(observations.residual)
        self._whitening = Whitening(bins, shape, errors, constants, rounding)

    def innovation(self, residual: Floats) -> Floats:
        """(n, 21) of a residual, the part that the other channels do not foretell, about 0, counts."""
        around = residual - residual[self._bins.order].mean(axis=0)
        return np.asarray(self._whiten(around) @ self._root / np.diag(self._precision))

    def best(self, effect: Effect, left: Floats, remaining: Remaining) -> Score | None:
        """The likeliest change of a few channels by an effect; None if the effect has no such forms.

        Args:
            left: (n, 21) the residual that no named effect explains, counts.
            remaining: the same for the effect's forms.
        """
        centred, resting, foreseen = self._candidates(effect, left, remaining)
        if not centred:
            return None
        bases = self._bases(left)
        options = [
            (int(channel), place)
            for channel in np.arange(len(CHANNELS))[ELECTRODE_COLUMNS]
            for place, candidate in enumerate(centred)
            if self._image(candidate, int(channel))[1].all()
        ]
        usual = self._usual(effect.name, len(options))

        def evidence(forms: Sequence[Candidate], chosen: dict[int, int]) -> float:
            form = self._form(forms, chosen)
            own = weigh(Products.of(bases.beside, form.design), TOGETHER, self._constants)
            return float(own.log_evidence - usual.price[list(chosen)].sum())

        alone: dict[int, tuple[float, int]] = {}
        for channel, place in options:
            alone[channel] = max(
                alone.get(channel, (0.0, -1)), (evidence(centred, {channel: place}), place)
            )
        chosen: dict[int, int] = {}
        best: Score | None = None
        for channel, (value, place) in sorted(alone.items(), key=lambda one: -one[1][0]):
            if value <= 0:
                break
            both = {**chosen, channel: place}
            forms = self._form(centred, both), self._form(resting, both)
            score = self._scored(effect, forms, bases, usual, best)
            follows = evidence(foreseen, {channel: place}) > 0
            if follows and self._repeats(score, best, channel):
                chosen, best = both, score
            if not chosen or len(chosen) > MOST_CHANNELS:
                # Where the likeliest one proves nothing, those that do may only stand for its cause.
                return None
        return best

    def _repeats(self, score: Score, before: Score | None, channel: int) -> bool:
        """Whether one channel more is likelier and repeats over the folds."""
        likelier = score.log_evidence > (0.0 if before is None else before.log_evidence)
        return bool(likelier and score.channel_t[channel] >= self._constants.least_t)

    def _scored(
        self,
        effect: Effect,
        forms: tuple[JointForm, JointForm],
        bases: "JointBases",
        usual: "Usual",
        before: Score | None,
    ) -> Score:
        """A change of one channel more than there were before.

        Args:
            forms: about the mean, and about rest, which is taken where it is likelier.
        """
        form, about_rest = forms
        products = Products.of(bases.beside, form.design)
        weighed = weigh(products, TOGETHER, self._constants)
        log_evidence = float(weighed.log_evidence - usual.price[form.channels].sum())
        plain = replace(Products.of(bases.beside, about_rest.design), base=bases.plain)
        alone = weigh(plain, TOGETHER, self._constants).log_evidence
        needs_constant = weighed.log_evidence + bases.constant >= alone
        found = held_out(products, TOGETHER, weighed)
        anyway = np.bincount(self._bins.fold)[:, None] * usual.gain * form.included
        # Channels are not free of each other: one more is given what it adds to the gain of all.
        gain = np.zeros_like(anyway) if before is None else before.gain.copy()
        gain[:, form.places[-1][0]] = (found.gain - anyway - gain).sum(axis=1)
        # A channel that errs less than on the reference is not judged by that little.
        error = np.maximum(found.before.sum(axis=0), len(self._bins))
        return Score(
            effect=effect,
            form=form if needs_constant else replace(about_rest, design=form.design, sizes=form.sizes),
            weighed=weighed,
            log_evidence=log_evidence,
            needs_constant=needs_constant,
            gain=gain,
            worth=gain.sum(axis=0) / error,
            taken_off=gain.sum(axis=0) * found.noise,
            usual=anyway,
            most_gain=float(gain.sum()),
            forms=((form.freedom, log_evidence),),
        )

    def weights(self, form: JointForm, left: Floats, strength: float, fold: int | None) -> Floats:
        """(21, k) weights of a form by the fit part, or all of it but one fold."""
        products = Products.of(self._bases(left).beside, form.design)
        kept = None if fold is None else np.arange(products.folds) != fold
        every = Weighed(0.0, strength, np.ones(len(CHANNELS)), np.zeros(len(CHANNELS)))
        _, scaled = posterior_weights(products, TOGETHER, every, kept)
        return form.weights(scaled)

    def beside(self, form: JointForm, left: Floats) -> tuple[Weighed, HeldOut]:
        """A named form, weighed and tested for what other effects leave (n, 21), counts."""
        products = Products.of(self._bases(left).beside, form.design)
        weighed = weigh(products, TOGETHER, self._constants)
        found = held_out(products, TOGETHER, weighed)
        gain = found.gain.sum(axis=1)[:, None] * form.included / form.included.sum()
        return weighed, HeldOut(gain, found.before, np.ones(len(CHANNELS)))

    def log_evidence(self, effect: str, forms: Sequence[Candidate], left: Floats) -> float:
        """Of an effect of many channels, in its likeliest form, on the scale of these forms."""
        known = self._known.structure.get(effect)
        usual = 0.0 if known is None else len(self._bins) * np.array(known.log_evidence)
        found = [
            weigh(each, fitting, self._constants, usual) for each, fitting in self._products(forms, left)
        ]
        return max((one.log_evidence for one in found), default=0.0)

    def common_structure(self, forms: Sequence[Candidate], left: Floats) -> OwnStructure:
        """What an effect of many channels explains: log odds of each whitened channel, by bins."""
        found = [weigh(each, fitting, self._constants) for each, fitting in self._products(forms, left)]
        odds = np.max([np.maximum(one.by_channel, 0.0) for one in found], axis=0) / len(self._bins)
        return OwnStructure(log_evidence=tuple(odds.tolist()), gain=(0.0,) * len(CHANNELS))

    def _products(self, forms: Sequence[Candidate], left: Floats) -> Iterator[tuple[Products, Fitting]]:
        """Of forms of many channels, as the whitened channels show them."""
        together = self._bases(left).beside
        base = replace(together, known_noise=None)
        scale = self._whitening.scale[:, None]
        for candidate in forms:
            fitting, means = candidate.fitting, self._bins.of_basis(candidate.basis)
            if len(means) > 1 and means.shape[2] == 1 and not (fitting.fixed or fitting.pooled):
                # A weight of each channel, all fitted together.
                images = [self._image(candidate, channel)[0] for channel in range(len(CHANNELS))]
                yield (
                    Products.of(together, Design(np.concatenate(images, axis=2), self._bins.fold)),
                    TOGETHER,
                )
                continue
            every = np.broadcast_to(means, (len(CHANNELS), *means.shape[1:]))
            if fitting.fixed or fitting.pooled:
                image = np.einsum("cd,dbk->cbk", self._root, every, optimize=True)
            elif len(means) == 1:
                # Weights of each whitened channel are sums of those of the channels.
                image = every
            else:
                image = np.diag(self._root)[:, None, None] * every
            if not fitting.fixed:
                size = np.sqrt((image**2).mean(axis=1)) / scale
                size = np.sqrt((size**2).mean(axis=0, keepdims=True)) if fitting.pooled else size
                image = image / np.where(size > 1e-9, size, np.inf)[:, None, :]
            design = Design(self._whitening(image), self._bins.fold)
            # Which channels a form may change says nothing of whitened ones.
            yield Products.of(base, design), replace(fitting, allowed=None)

    def structure(self, effect: Effect, remaining: Remaining, confidence: float) -> OwnStructure | None:
        """What an effect explains in each electrode alone: log odds and gain over the noise, by bins.

        Args:
            confidence: of the limit of what few blocks leave open.
        """
        left = remaining.residual
        centred, _, _ = self._candidates(effect, left, remaining)
        if not centred:
            return None
        bases = self._bases(left)
        log_evidence, gain = np.zeros((2, len(CHANNELS)))
        for channel in np.arange(len(CHANNELS))[ELECTRODE_COLUMNS]:
            for place, candidate in enumerate(centred):
                if not self._image(candidate, channel)[1].all():
                    continue
                form = self._form(centred, {int(channel): place})
                products = Products.of(bases.beside, form.design)
                weighed = weigh(products, TOGETHER, self._constants)
                log_evidence[channel] = max(log_evidence[channel], weighed.log_evidence)
                seen, unseen = (
                    held_out(products, TOGETHER, weighed, seen=one).gain.sum(axis=1)
                    for one in (True, False)
                )
                folds = len(seen)
                error = corrected_standard_error(folds * seen, 1.0 / (folds - 1))
                limit = float(stats.t.ppf(confidence, folds - 1))
                own = max(0.5 * float((seen + unseen).sum()), 0.0) + limit * error
                gain[channel] = max(gain[channel], own)
        bins = len(self._bins)
        return OwnStructure(
            log_evidence=tuple((log_evidence / bins).tolist()), gain=tuple((gain / bins).tolist())
        )

    def _usual(self, effect: str, choices: int) -> "Usual":
        price = np.full(len(CHANNELS), np.log(max(choices, 1)))
        if effect not in self._known.structure:
            return Usual(price, np.zeros(len(CHANNELS)))
        own = self._known.structure[effect]
        return Usual(price + len(self._bins) * np.array(own.log_evidence), np.array(own.gain))

    def _candidates(
        self, effect: Effect, left: Floats, remaining: Remaining
    ) -> tuple[list[Candidate], list[Candidate], list[Candidate]]:
        """The effect's forms of each channel: about the mean, about rest, and of predicted signals alone.

        What is measured of a source holds its own errors, which a channel seems to follow where these are
        larger than they were. A true leak or gain follows the predicted part of the signal as well.
        """
        if effect.follows is None:
            return [], [], []
        innovation = self.innovation(left)
        measured = self._observations.measured
        # What the other channels and the model foretell has no part of the channel's own error.
        expected = measured - innovation
        seen = measured if effect.follows == "measured" else expected
        other = replace(remaining, residual=innovation)
        mean = seen[self._bins.order].mean(axis=0)
        about_mean = list(self._forms(effect, self._observations.seen_as(seen, expected, mean), other))
        rest = self._observations.seen_as(seen, expected, None)
        about_rest = list(self._forms(effect, rest, other))
        foreseen = [one.again(self._observations) for one in about_mean if one.again is not None]
        self.__dict__.pop("_cached", None)
        return about_mean, about_rest, foreseen

    @staticmethod
    def _forms(effect: Effect, seen: Observations, remaining: Remaining) -> Iterator[Candidate]:
        for candidate in effect.forms(seen, remaining):
            fitting = candidate.fitting
            if not (fitting.pooled or fitting.fixed):
                yield replace(candidate, fitting=replace(fitting, jointly=True))

    @cached_property
    def _cached(self) -> dict[tuple[int, int], tuple[Floats, Floats]]:
        return {}

    def _image(self, candidate: Candidate, channel: int) -> tuple[Floats, Floats]:
        """A channel's regressors as all whitened channels show them (21, bins, k), and their sizes (k,)."""
        key = id(candidate), channel
        if key not in self._cached:
            means = self._bins.of_basis(candidate.basis)
            own = means[channel if len(means) > 1 else 0]
            image = self._root[:, channel, None, None] * own[None]
            relative = image / self._whitening.scale[:, None, None]
            size = np.sqrt((relative**2).mean(axis=1).sum(axis=0))
            safe = np.where(size > 1e-9, size, np.inf)
            self._cached[key] = self._whitening(image / safe), np.where(size > 1e-9, size, 0.0)
        return self._cached[key]

    def _form(self, candidates: Sequence[Candidate], chosen: dict[int, int]) -> JointForm:
        """Some channels together, each with one of the effect's forms: the larger form holds them all."""
        largest = max(chosen.values(), key=lambda place: candidates[place].basis.size)
        candidate = candidates[largest]
        values, sizes, places = [], [], []
        for channel, place in chosen.items():
            image, size = self._image(candidates[place], channel)
            values.append(image)
            sizes.append(size)
            places += [(channel, column) for column in range(len(size))]
        included = np.isin(np.arange(len(CHANNELS)), list(chosen))
        names = ", ".join(CHANNELS[channel] for channel in sorted(chosen))
        form = replace(
            candidate,
            form=f"{candidate.form}: {names}, beside all others",
            fitting=replace(candidate.fitting, allowed=included),
        )
        design = Design(np.concatenate(values, axis=2), self._bins.fold)
        unit = np.ones((len(CHANNELS), candidate.basis.size))
        return JointForm(form, design, unit, tuple(places), np.concatenate(sizes))

    def _bases(self, left: Floats) -> "JointBases":
        errors = self._whiten(left)
        target = Design(self._whitening(self._bins.means(errors.T[:, :, None])), self._bins.fold)
        nothing = Design(np.empty((len(CHANNELS), len(self._bins), 0)), self._bins.fold)
        scale = self._whitening.scale
        ones = Design(
            self._whitening(np.broadcast_to(scale[:, None, None], (len(CHANNELS), len(self._bins), 1))),
            self._bins.fold,
        )
        none = np.empty((len(CHANNELS), 0))
        # An error of 1 is what the model's own held-out residual has.
        empty = Base(target, nothing, none, self._whitening.quantum, known_noise=scale**-2)
        beside = empty.with_constant(ones)
        plain = beside.without_last()
        constant = weigh(Products.of(plain, ones), Fitting(), self._constants).log_evidence
        return JointBases(plain, beside, constant)


class JointBases(NamedTuple):
    """What forms are weighed beside, and the evidence of the constant between the two."""

    plain: Base
    beside: Base
    constant: float


class Usual(NamedTuple):
    """What is taken from an effect.

    Attributes:
        price: (21,) log odds, for having chosen a channel and a form, and of the model's own residual.
        gain: (21,) of the model's own residual, over the noise, for each bin.
    """

    price: Floats
    gain: Floats

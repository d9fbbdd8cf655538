"""The likeliest change of a few channels: they join, then those go that prove nothing beside the others."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from taxel.channels import CHANNELS
from taxel.corrections import saturation_design
from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Effect, Remaining
from taxel_models.loop.effects.saturation import levels_of
from taxel_models.loop.inference.correlated_channels import CorrelatedChannels, Signals
from taxel_models.loop.inference.evidence import Weighed, held_out, weigh
from taxel_models.loop.inference.few_channels_form import TOGETHER, ChannelForms, FewChannelsForm
from taxel_models.loop.inference.named_in_channels import NamedInChannels
from taxel_models.loop.inference.products import Products
from taxel_models.loop.inference.score import Score, t_of_folds
from taxel_models.loop.inference.shape import Shape
from taxel_models.loop.inference.usual import bins_that_count
from taxel_models.loop.observations import Observations

MOST_CHANNELS: Final = 5
"""Channels of one form. A cause that all channels have, such as a wave, shows in more of them: it is no
change of a few, though each channel follows its neighbours."""

SPARE: Final = 4
"""So many more may join before those go that prove nothing."""


class Added(NamedTuple):
    """What a channel adds to a change of others.

    Attributes:
        channel: which.
        log_evidence: more than without it.
        seen: (folds,) gain with weights of all folds, more than without it.
        unseen: (folds,) likewise, with weights of the other folds.
    """

    channel: int
    log_evidence: float
    seen: Floats
    unseen: Floats


class FewChannelsSearch:
    """Looks for changes of a few channels by one effect in what named effects leave.

    Args:
        channels: which weigh.
        observations: the recordings with the model's predictions.
        remaining: what no named effect explains.
        beside: what changes are weighed beside.
        effect: that `follows` signals.
    """

    def __init__(
        self,
        channels: CorrelatedChannels,
        observations: Observations,
        remaining: Remaining,
        beside: NamedInChannels,
        effect: Effect,
    ) -> None:
        self._channels, self._observations, self._remaining = channels, observations, remaining
        self._beside, self._effect = beside, effect
        self._kinds = channels.signals(effect, observations, remaining)
        # Half of it is asked of each channel beside the others, as of a named effect.
        self._least_t = channels.constants.least_t(channels.bins.folds)

    def best(self, most_channels: int = MOST_CHANNELS) -> Score | None:
        """The likeliest change; None without one, and where more channels than these change."""
        choices = sum(len(signals.about_mean.options) for signals in self._kinds)
        # The log odds of each channel, for having chosen it and its form, and of the model's own residual.
        price = np.log(max(choices, 1)) + self._channels.usual_odds(self._effect.name)
        found = [self._likeliest(signals, price, most_channels) for signals in self._kinds]
        return max(
            (one for one in found if one is not None), key=lambda one: one.log_evidence, default=None
        )

    def alone(self) -> Iterator[Added]:
        """What each channel adds to no others."""
        for signals in self._kinds:
            for channel, place in signals.about_mean.options:
                products = self._beside.products(signals.about_mean.design({channel: place}), [channel])
                weighed = weigh(products, TOGETHER, self._channels.constants)
                seen, unseen = (_gains(products, weighed, seen=one) for one in (True, False))
                yield Added(channel, weighed.log_evidence, seen, unseen)

    def added(self) -> Iterator[Added]:
        """What each channel adds to others that join with it, where nothing is usual."""
        for signals in self._kinds:
            chosen = self._joined(signals, np.zeros(len(CHANNELS)), MOST_CHANNELS)
            if len(chosen) < 2:
                continue
            form = signals.about_mean.form(chosen)
            products = self._beside.products(form.design, chosen)
            weighed = weigh(products, TOGETHER, self._channels.constants)
            seen, unseen = (_gains(products, weighed, seen=one) for one in (True, False))
            for channel in chosen:
                others = _without(products, form, channel)
                odds = weigh(others, TOGETHER, self._channels.constants).log_evidence
                yield Added(
                    channel,
                    weighed.log_evidence - odds,
                    seen - _gains(others, weighed, seen=True),
                    unseen - _gains(others, weighed, seen=False),
                )

    def _likeliest(self, signals: Signals, price: Floats, most_channels: int) -> Score | None:
        """The likeliest change of a few channels that is in proportion to signals of one kind.

        Channels join while the evidence rises. Then those go that prove nothing beside all others, the
        weakest first: a change of two neighbours hides each of them from what the other foretells.
        """
        chosen = self._joined(signals, price, most_channels)
        likeliest = next(iter(chosen), None)
        while chosen:
            score, conditional = self._judged(signals, price, chosen)
            unproven = [
                channel
                for channel, place in chosen.items()
                if t_of_folds(conditional[:, channel]) < self._least_t / 2
                or not self._is_possible(score, signals.predicted, channel, place)
            ]
            if not unproven:
                # Where the likeliest one proves nothing, those that do may only stand for its cause.
                few = likeliest in chosen and len(chosen) <= most_channels
                return score if few and score.log_evidence > 0 else None
            del chosen[min(unproven, key=lambda channel: float(conditional[:, channel].sum()))]
        return None

    def _joined(self, signals: Signals, price: Floats, most_channels: int) -> dict[int, int]:
        """Channels that make the evidence rise, the likeliest first, each with the place of its form.

        Args:
            price: (21,) log odds that are taken from a change of each channel.
        """
        forms = signals.about_mean
        found: dict[int, dict[int, float]] = {}
        for channel, place in forms.options:
            found.setdefault(channel, {})[place] = self._evidence(forms, {channel: place}, price)
        chosen: dict[int, int] = {}
        reached = 0.0
        for channel, own in sorted(found.items(), key=lambda one: -max(one[1].values())):
            able = [(own[place], place) for place in forms.beside(chosen, [*own])]
            own_odds, place = max(able, default=(0.0, 0))
            if own_odds <= 0 or len(chosen) >= most_channels + SPARE:
                break
            more = {**chosen, channel: place}
            log_evidence = self._evidence(forms, more, price)
            least = self._channels.constants.foretold * own_odds
            foretold = self._evidence(signals.predicted, {channel: place}, price) > least
            if foretold and log_evidence > reached:
                chosen, reached = more, log_evidence
            if not chosen:
                # Without the likeliest one, the others are no change that can be told.
                break
        return chosen

    def _evidence(self, forms: ChannelForms, chosen: dict[int, int], price: Floats) -> float:
        """The log evidence of a change of some channels."""
        products = self._beside.products(forms.design(chosen), chosen)
        found = weigh(products, TOGETHER, self._channels.constants).log_evidence
        return found - float(price[[*chosen]].sum())

    def _is_possible(self, score: Score, predicted: ChannelForms, channel: int, place: int) -> bool:
        """Whether its effect can make a channel's weights, and no added counts or bend are nearer."""
        assert isinstance(score.form, FewChannelsForm)
        weights = self._channels.weights(score.form, self._beside, score.weighed.strength)[0, channel]
        if (np.abs(weights) > self._effect.most_weight).any():
            return False
        bins, left = self._channels.bins, self._remaining.residual
        shape = Shape.of(predicted.candidates[place], channel, self._observations.measured, left, bins)
        if shape.is_added:
            return False
        # What a leak adds is less than what all channels have in common, and that may bend as well.
        may_bend = self._effect.follows == "expected"
        return not (may_bend and shape.is_bent(bend[:, channel] for bend in self._bends))

    @cached_property
    def _bends(self) -> list[Floats]:
        """(rows of the fit part, 21) each, what a saturation adds from a level on."""
        signal = self._observations.signal[self._channels.bins.order]
        levels = levels_of(self._observations, self._remaining.fit)
        return [saturation_design(signal, level) for level in levels]

    def _judged(self, signals: Signals, price: Floats, chosen: dict[int, int]) -> tuple[Score, Floats]:
        """A change of some channels, and (folds, 21) what each adds to the gain of the others."""
        form, about_rest = signals.about_mean.form(chosen), signals.about_rest.form(chosen)
        bases = self._beside.bases(chosen)
        products = self._beside.products(form.design, chosen)
        weighed = weigh(products, TOGETHER, self._channels.constants)
        log_evidence = weighed.log_evidence - float(price[form.channels].sum())
        plain = replace(self._beside.products(about_rest.design, chosen), base=bases.plain)
        alone = weigh(plain, TOGETHER, self._channels.constants).log_evidence
        needs_constant = weighed.log_evidence + bases.constant >= alone
        found = held_out(products, TOGETHER, weighed)
        change = found.squared_change.sum(axis=1, keepdims=True)
        bins = bins_that_count(form.candidate, np.bincount(self._channels.bins.fold)[:, None], change)
        usual = bins * self._channels.usual_gain(self._effect.name) * form.included
        every = found.gain.sum(axis=1)
        conditional = -usual
        for channel in chosen:
            conditional[:, channel] += every - _gains(_without(products, form, channel), weighed)
        # Channels are not free of each other: what none adds by itself is shared.
        together = every - usual.sum(axis=1) - conditional.sum(axis=1)
        gain = conditional + together[:, None] * form.included / len(chosen)
        # A channel that errs less than on the reference is not judged by that little.
        error = np.maximum(found.before.sum(axis=0), len(self._channels.bins))
        score = Score(
            effect=self._effect,
            form=form if needs_constant else replace(about_rest, design=form.design, sizes=form.sizes),
            weighed=replace(weighed, included=form.included),
            log_evidence=log_evidence,
            needs_constant=needs_constant,
            gain=gain,
            worth=gain.sum(axis=0) / error,
            usual=usual,
            forms=((form.freedom, log_evidence),),
        )
        return score, conditional


def _without(products: Products, form: FewChannelsForm, channel: int) -> Products:
    """Those of the other channels of a form."""
    return products.of_some([place for place, (owner, _) in enumerate(form.places) if owner != channel])


def _gains(products: Products, weighed: Weighed, *, seen: bool = False) -> Floats:
    """(folds,) of all channels together; see `held_out`."""
    return np.asarray(held_out(products, TOGETHER, weighed, seen=seen).gain.sum(axis=1))

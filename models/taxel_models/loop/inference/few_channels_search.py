"""The likeliest change of a few channels: one channel after the other, each proven beside those before."""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from taxel_models.loop.effects.effect import Effect, Remaining
from taxel_models.loop.inference.correlated_channels import CorrelatedChannels, Price, Signals
from taxel_models.loop.inference.evidence import held_out, weigh
from taxel_models.loop.inference.few_channels_form import TOGETHER, ChannelForms, FewChannelsForm
from taxel_models.loop.inference.named_in_channels import NamedInChannels
from taxel_models.loop.inference.score import Score
from taxel_models.loop.inference.shape import is_added
from taxel_models.loop.inference.usual import bins_that_count
from taxel_models.loop.observations import Observations

MOST_CHANNELS: Final = 5
"""Channels of one form. A cause that all channels have, such as a wave, shows in more of them: it is no
change of a few, though each channel follows its neighbours."""


class Sought(NamedTuple):
    """What is looked for.

    Attributes:
        effect: that changes a few channels.
        price: of a change.
        most_channels: where more of them change, nothing is found.
    """

    effect: Effect
    price: Price
    most_channels: int


class FewChannelsSearch:
    """Looks for changes of a few channels in what named effects leave.

    Args:
        channels: which weigh.
        observations: the recordings with the model's predictions.
        remaining: what no named effect explains.
        beside: what changes are weighed beside.
    """

    def __init__(
        self,
        channels: CorrelatedChannels,
        observations: Observations,
        remaining: Remaining,
        beside: NamedInChannels,
    ) -> None:
        self._channels, self._observations, self._remaining = channels, observations, remaining
        self._beside = beside
        # That each channel must reach.
        self._least_t = channels.constants.least_t(channels.folds)

    def best(self, effect: Effect, most_channels: int = MOST_CHANNELS) -> Score | None:
        """The likeliest change by an effect that `follows` signals; None without one.

        Args:
            effect: which.
            most_channels: where more of them change, there is none either.
        """
        kinds = self._channels.signals(effect, self._observations, self._remaining)
        choices = sum(len(signals.about_mean.options) for signals in kinds)
        sought = Sought(effect, self._channels.price(effect.name, choices), most_channels)
        found = [self._likeliest(sought, signals) for signals in kinds]
        return max(
            (one for one in found if one is not None), key=lambda one: one.log_evidence, default=None
        )

    def _likeliest(self, sought: Sought, signals: Signals) -> Score | None:
        """The likeliest change of a few channels that is in proportion to signals of one kind."""
        forms = signals.about_mean

        def odds(forms: ChannelForms, channel: int, place: int) -> float:
            products = self._beside.products(forms.design({channel: place}), [channel])
            return weigh(products, TOGETHER, self._channels.constants).log_evidence - float(
                sought.price.odds[channel]
            )

        found: dict[int, dict[int, float]] = {}
        for channel, place in forms.options:
            found.setdefault(channel, {})[place] = odds(forms, channel, place)
        chosen: dict[int, int] = {}
        best: Score | None = None
        for channel, own in sorted(found.items(), key=lambda one: -max(one[1].values())):
            able = [(own[place], place) for place in forms.beside(chosen, [*own])]
            own_odds, place = max(able, default=(0.0, 0))
            if own_odds <= 0:
                break
            more = {**chosen, channel: place}
            score = self._scored(sought, signals, more, best)
            least = self._channels.constants.foretold * own_odds
            proven = score.channel_t[channel] >= self._least_t
            proven = proven and odds(signals.predicted, channel, place) > least
            likelier = score.log_evidence > (0.0 if best is None else best.log_evidence)
            if proven and likelier and self._is_possible(sought, score, signals.predicted, channel, place):
                chosen, best = more, score
            if not chosen or len(chosen) > sought.most_channels:
                # Where the likeliest one proves nothing, those that do may only stand for its cause.
                return None
        return best

    def _is_possible(
        self, sought: Sought, score: Score, predicted: ChannelForms, channel: int, place: int
    ) -> bool:
        """Whether its effect can make a channel's weights, and added counts explain it no better."""
        assert isinstance(score.form, FewChannelsForm)
        weights = self._channels.weights(score.form, self._beside, score.weighed.strength)[0, channel]
        if (np.abs(weights) > sought.effect.most_weight).any():
            return False
        return not is_added(
            predicted.candidate(place),
            channel,
            self._observations.measured,
            self._remaining.residual,
            self._channels.bins,
        )

    def _scored(
        self, sought: Sought, signals: Signals, chosen: dict[int, int], before: Score | None
    ) -> Score:
        """A change of one channel, the last of the chosen ones, more than there were before."""
        form, about_rest = signals.about_mean.form(chosen), signals.about_rest.form(chosen)
        bases = self._beside.bases(chosen)
        products = self._beside.products(form.design, chosen)
        weighed = weigh(products, TOGETHER, self._channels.constants)
        log_evidence = weighed.log_evidence - float(sought.price.odds[form.channels].sum())
        plain = replace(self._beside.products(about_rest.design, chosen), base=bases.plain)
        alone = weigh(plain, TOGETHER, self._channels.constants).log_evidence
        needs_constant = weighed.log_evidence + bases.constant >= alone
        found = held_out(products, TOGETHER, weighed)
        change = found.squared_change.sum(axis=1, keepdims=True)
        bins = bins_that_count(form.candidate, np.bincount(self._channels.bins.fold)[:, None], change)
        usual = bins * sought.price.gain * form.included
        # Channels are not free of each other: one more is given what it adds to the gain of all.
        gain = np.zeros_like(usual) if before is None else before.gain.copy()
        gain[:, form.places[-1][0]] = (found.gain - usual - gain).sum(axis=1)
        # A channel that errs less than on the reference is not judged by that little.
        error = np.maximum(found.before.sum(axis=0), len(self._channels.bins))
        return Score(
            effect=sought.effect,
            form=form if needs_constant else replace(about_rest, design=form.design, sizes=form.sizes),
            weighed=replace(weighed, included=form.included),
            log_evidence=log_evidence,
            needs_constant=needs_constant,
            gain=gain,
            worth=gain.sum(axis=0) / error,
            taken_off=gain.sum(axis=0) * found.noise,
            usual=usual,
            most_gain=float(gain.sum()),
            forms=((form.freedom, log_evidence),),
        )

"""All channels together: what they show of an effect, beside those that are named already."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import cache

from taxel.channels import CHANNELS
from taxel_models.loop.effects.effect import Candidate, Effect
from taxel_models.loop.inference.correlated_channels import CorrelatedChannels, OfMany
from taxel_models.loop.inference.evidence import Bases
from taxel_models.loop.inference.few_channels_search import MOST_CHANNELS, FewChannelsSearch
from taxel_models.loop.inference.proof import stands
from taxel_models.loop.inference.score import Score


class AllChannels:
    """Judges scores by all channels together, whose errors are correlated.

    Args:
        correlated: channels, which weigh.
        effects: that compete, without those that are named.
        forms: gives an effect's forms.
        search: gives the search for changes of few channels by an effect that `follows` signals.
        bases: what effects of many channels are weighed beside.
        rivals: labels of effects that may be likelier than a change of few channels.
        beside_others: something is named already.
    """

    def __init__(
        self,
        correlated: CorrelatedChannels,
        effects: Sequence[Effect],
        forms: Callable[[Effect], Sequence[Candidate]],
        search: Callable[[Effect], FewChannelsSearch],
        *,
        bases: Bases,
        rivals: Collection[str],
        beside_others: bool,
    ) -> None:
        self._correlated, self._effects, self._forms = correlated, effects, forms
        self._beside_others, self._constants = beside_others, correlated.constants
        self._search, self._rivals, self._bases = search, rivals, bases
        self._weighed = cache(self._weigh)

    def judged(self, score: Score) -> Score:
        """The same score, or one of few channels in its place, or without evidence.

        Changes of few channels take the place of their effect's other forms, where they prove themselves.
        What explains only the error that channels have in common anyway is no evidence.
        """
        proven = stands(score, self._beside_others, self._constants)
        few = self._few_channels(score.effect)
        if few is not None and few.log_evidence > self._rival(score.effect, few.total_gain):
            stronger = proven and score.log_evidence > few.log_evidence
            if not stronger:
                return few
        if proven and not self._shows(score, few):
            return replace(score, log_evidence=0.0)
        return score

    def _few_channels(self, effect: Effect) -> Score | None:
        """The likeliest change of a few channels that proves itself."""
        if effect.follows is None:
            return None
        few = self._search(effect).best()
        stand = few is not None and stands(few, self._beside_others, self._constants)
        return few if stand else None

    def _shows(self, score: Score, few: Score | None) -> bool:
        """Whether a proven effect shows in all channels together, too."""
        effect = score.effect
        if score.form.candidate.certain or not self._correlated.knows(effect.label):
            return True
        if effect.is_constant and score.worth.mean() < self._constants.least_share:
            # One channel's mean scatters from finger to finger: it must be large even beside a constant.
            return self._correlated.of_many(effect.label, self._forms(effect), self._bases).log_evidence > 0
        changes_few = score.weighed.changes.sum() <= MOST_CHANNELS
        changes_few |= score.worth.mean() < self._constants.least_share
        # What few channels show must show beside all others. By itself it repeats already.
        changes_few &= effect.follows is not None
        if changes_few and few is None and self._search(effect).best(most_channels=len(CHANNELS)) is None:
            return False
        least = self._rival(effect) if effect.follows == "measured" else 0.0
        return self._found(effect).log_evidence > least

    def _found(self, effect: Effect, but: str | None = None) -> OfMany:
        """What shows of an effect of many channels, in forms that do not contain another one."""
        contained = any(form.contains == but for form in self._forms(effect))
        return self._weighed(effect, but if contained else None)

    def _weigh(self, effect: Effect, but: str | None) -> OfMany:
        forms = [form for form in self._forms(effect) if but is None or form.contains != but]
        bases = self._bases.of_constant if effect.is_constant else self._bases
        return self._correlated.of_many(effect.label, forms, bases)

    def _rival(self, effect: Effect, gain: float = 0.0) -> float:
        """The evidence of the likeliest other effect of many channels that does not contain this one.

        Args:
            gain: one that removes less of what was held out is no rival, however likely it is.
        """
        # All are weighed beside a constant already.
        others = (
            one
            for one in self._effects
            if one is not effect and one.follows != "measured" and not one.is_constant
        )
        rivals = [one for one in others if one.label in self._rivals and not one.is_costly]
        found = (self._found(one, effect.name) for one in rivals)
        return max((one.log_evidence for one in found if one.gain >= gain), default=0.0)

"""All declared constants of the inference."""

from dataclasses import dataclass, fields, replace
from typing import Final, Self

from scipy import stats

BINS_OF_FADING: Final = 10
"""Bins in the time constant of the noise that fades: rows nearer to each other tell nearly the same."""


@dataclass(frozen=True)
class Constants:
    """What the inference takes as given.

    Attributes:
        fading_s: time constant of the part of the noise that fades, s; rows are counted in bins of a tenth.
        strength: middle of the three prior sizes of an effect, over the channel's residual; the others
            are a fourth of it and four times as much.
        least_included: least of the prior shares of the channels that an effect changes; the others
            are one half and all.
        robust: a block counts less if its error is more than so many times the median block's.
        chance: probability with which chance alone reaches the t over held-out folds that an effect must
            reach (Nadeau and Bengio 2003); see `least_t`.
        least_share: share of the held-out squared error, counts², that an effect must remove.
        least_channel_share: likewise in one channel, which must pass the test by itself, as one of many;
            and over all channels, beside named effects, where a form that is not quite right leaves a
            little. Offsets of contacts, which no model predicts, must remove so much of the whole error.
        clear_share: an effect that removes less over all channels must be surer: `chance` falls in
            proportion. A constant, and beside named effects a change of few channels or a saturation,
            must remove so much in one channel: a channel's mean scatters from finger to finger.
        alike: an effect that explains this share of what another does is not told apart from it, if its
            evidence is this share of the other's, too; if it is the simpler one, it is named first.
        simpler: a simpler effect has at most this share of the other's parameters.
        foretold: share of the evidence for a change of a few channels that the model's prediction alone
            must give.
        usual_of_kind: a recording of one kind may show so many times what was held out of the kind, and
            more where few contacts were. Of waves, any recording may; of offsets of contacts, half as much
            beyond it.
    """

    fading_s: float = 1.0
    strength: float = 0.5
    least_included: float = 0.1
    robust: float = 1.0
    chance: float = 0.01
    least_share: float = 0.03
    least_channel_share: float = 0.05
    clear_share: float = 0.15
    alike: float = 0.67
    simpler: float = 0.5
    foretold: float = 0.1
    usual_of_kind: float = 2.0

    def moved(self, name: str, factor: float) -> Self:
        """The same with one constant multiplied."""
        return replace(self, **{name: factor * getattr(self, name)})

    def with_new_kinds(self, share: float) -> Self:
        """The same where a share of the rows is of kinds that the model was not trained on.

        What the model lacks there repeats as well, so that only what removes much is told from it: each
        share gives way to the next larger one, and the largest rises by as much as the one below it.
        """
        part, clear = share**2, self.clear_share

        def raised(usual: float, larger: float) -> float:
            return (1.0 - part) * usual + part * larger

        return replace(
            self,
            least_share=raised(self.least_share, clear),
            least_channel_share=raised(self.least_channel_share, clear),
            clear_share=raised(clear, min(clear**2 / self.least_channel_share, 1.0)),
        )

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Of all constants."""
        return tuple(field.name for field in fields(cls))

    def least_t(self, folds: int, part: float = 1.0) -> float:
        """The t over so many held-out folds that chance reaches with a part of its probability."""
        return float(stats.t.isf(part * self.chance, max(folds - 1, 1)))

    @property
    def bin_s(self) -> float:
        """Length of a bin, s."""
        return self.fading_s / BINS_OF_FADING

    @property
    def strengths(self) -> tuple[float, ...]:
        """Prior sizes that the evidence is averaged over."""
        return (self.strength / 4, self.strength, 4 * self.strength)

    @property
    def included(self) -> tuple[float, ...]:
        """Prior shares of the channels that the evidence is averaged over."""
        return (1.0, 0.5, min(self.least_included, 1.0))


DECLARED: Final = Constants()

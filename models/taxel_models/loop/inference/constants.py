"""All declared constants of the inference."""

from dataclasses import dataclass, fields, replace
from typing import Final, Self

CLEAR: Final = 3.0
"""The share of one channel that is clear, over the least one."""

MOST: Final = 0.5
"""The share of one channel that is clear on kinds that the model was not trained on."""

FORETOLD: Final = 0.1
"""The share of the evidence for a change of a few channels that the model's prediction alone must give."""


@dataclass(frozen=True)
class Constants:
    """What the inference takes as given.

    Attributes:
        bin_s: length of a bin, s: rows nearer to each other tell nearly the same.
        fading_s: time constant of the part of the noise that fades, s.
        strength: middle of the three prior sizes of an effect, over the channel's residual; the others
            are a fourth of it and four times as much.
        least_included: least of the prior shares of the channels that an effect changes; the others
            are one half and all.
        robust: a block counts less if its error is more than so many times the median block's.
        least_t: t over held-out folds that an effect must reach (Nadeau and Bengio 2003).
        least_share: share of the held-out whitened squared error that an effect must remove.
        least_channel_share: likewise in one channel, where it changes few; that channel must pass the test
            by itself; see also `clear_share`. Offsets of contacts, which no model predicts, must remove so
            much of the whole error.
        carries: a simpler effect is named first if it explains this share of what the likeliest does.
        either: two effects are not told apart if one explains this share of what the other does.
        simpler: a simpler effect has at most this share of the other's parameters.
        most_effects: named at most.
    """

    bin_s: float = 0.1
    fading_s: float = 1.0
    strength: float = 0.5
    least_included: float = 0.1
    robust: float = 1.0
    least_t: float = 3.0
    least_share: float = 0.03
    least_channel_share: float = 0.05
    carries: float = 0.67
    either: float = 0.8
    simpler: float = 0.5
    most_effects: int = 8

    def moved(self, name: str, factor: float) -> Self:
        """The same with one constant multiplied; a count stays whole and at least 1."""
        value = factor * getattr(self, name)
        return replace(self, **{name: max(1, round(value)) if name == "most_effects" else value})

    def with_new_kinds(self, share: float) -> Self:
        """The same where a share of the rows is of kinds that the model was not trained on.

        What the model lacks there repeats as well, so that only what removes much is told from it: a
        `clear_share` of the whole error, or half of a channel's.
        """
        part = share**2
        return replace(
            self,
            least_share=(1.0 - part) * self.least_share + part * self.clear_share,
            least_channel_share=(1.0 - part) * self.least_channel_share + part * MOST / CLEAR,
        )

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Of all constants."""
        return tuple(field.name for field in fields(cls))

    @property
    def clear_share(self) -> float:
        """Three times `least_channel_share`: one channel with so much needs no price for being one of many.

        A constant, and what comes beside named effects, needs so much in one channel: a channel's mean
        scatters from finger to finger, and a form that is not quite right leaves a little.
        """
        return CLEAR * self.least_channel_share

    @property
    def strengths(self) -> tuple[float, ...]:
        """Prior sizes that the evidence is averaged over."""
        return (self.strength / 4, self.strength, 4 * self.strength)

    @property
    def included(self) -> tuple[float, ...]:
        """Prior shares of the channels that the evidence is averaged over."""
        return (1.0, 0.5, min(self.least_included, 1.0))


DECLARED: Final = Constants()

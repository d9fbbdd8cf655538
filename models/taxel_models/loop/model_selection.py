"""Model selection: chooses among the scores of one effect's forms, and among effects."""

import math
from collections.abc import Sequence
from typing import Final

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel_models.loop.basis import Floats
from taxel_models.loop.cross_validation import Score, difference_test

LEVEL: Final = 0.01
"""The family-wise level of a step: how often it may name an effect where there is none."""

CONTENDER_LEVEL: Final = 0.05
"""The family-wise level of other effects if one passes `LEVEL`: another may explain more."""

FOLD_LEVEL: Final = 0.025
"""The level of the t-test over folds: an effect of a few blocks may stand out, but it does not repeat."""

LEAST_SHARE: Final = 0.02
"""The least share of the residual's energy over all channels: less is not worth a new version."""

NEARLY: Final = 0.9
"""Effects worth at least this part of the most any effect is worth compete by their share of the energy."""

AS_GOOD: Final = 0.985
"""A form with fewer parameters is chosen if it explains at least this part of the best share."""

MUCH_SIMPLER: Final = 0.25
"""A much simpler effect has at most this part of the other's parameters."""

CLEARLY_LESS: Final = 0.005
"""The level of the t-test over folds at which a much simpler effect explains clearly less than the best."""

LEAST_CHANNEL_SHARE: Final = 0.15
"""The least share of one channel's energy: an effect of few channels matters to these."""

FEW: Final = 1 / 3
MUCH_BETTER: Final = 1.5
"""An effect of at most so many of the channels goes first if it explains so many times as much there."""

CONFOUNDED: Final = 0.8
"""Another effect can replace a named one if it explains at least this part of its share."""

CONTAINED: Final = 0.5
"""The same part for a much simpler effect, which the named one may contain."""


def contends(score: Score, p_value: float) -> bool:
    """Whether an effect stands out from chance clearly, or less clearly but in all folds."""
    return p_value <= LEVEL or (p_value <= CONTENDER_LEVEL and score.repeats <= FOLD_LEVEL)


def simplest(scores: Sequence[Score]) -> Score:
    """The best score, or one with fewer parameters that explains nearly as much."""
    best = max(scores, key=lambda score: score.share)
    near = [score for score in scores if score is best or score.share >= AS_GOOD * best.share > 0]
    return min(near, key=lambda score: (score.freedom, -score.share))


def steadiest(scores: Sequence[Score]) -> Score:
    """The simplest of the best forms. If it does not repeat over the folds, a much simpler one that does.

    A form with many parameters may explain most on average, but not in every fold.
    """
    best = simplest(scores)
    plain = [score for score in scores if score.repeats <= FOLD_LEVEL and _much_simpler(score, best)]
    return best if best.repeats <= FOLD_LEVEL or not plain else simplest(plain)


def worth_most(able: Sequence[tuple[float, Score]]) -> list[Score]:
    """The scores that are worth nearly the most over all channels.

    Much simpler effects stay, too, if they explain more of the energy than the one that is worth most. An
    example is a turned frame: many bumps over the skin imitate it, and they are worth a little more in mean
    absolute error.

    Args:
        able: scores with what they are worth.
    """
    most, top = max(able, key=lambda pair: pair[0])
    return [
        score
        for value, score in able
        if value >= NEARLY * most or (score.share > top.share and _much_simpler(score, top))
    ]


def likeliest(scores: Sequence[Score], scale: Floats) -> Score:
    """The effect that explains most, or the simplest one that does as well (`_does_as_well`).

    Among effects with the same number of parameters, two terms decide. The first is the data's support for
    the better one, t²/2. The second is how alike the electrodes' weights are: a common cause draws them
    from one narrow distribution.

    Args:
        scale: (21,) what an error of each channel counts, 1/counts².
    """
    best = max(scores, key=lambda score: score.share)
    level = [score for score in scores if score is best or _does_as_well(score, best)]

    def doubt(score: Score) -> float:
        t = 0.0 if score is best else score.against(best)[0]
        electrodes = len(CHANNELS[ELECTRODE_COLUMNS])
        # Without a limit, the weights' spread is a parameter, too (Schwarz 1978).
        open_ended = math.log(electrodes) / 2 if score.candidate.alike is None else 0.0
        return t**2 / 2 + electrodes * math.log(max(score.unlikeness(scale), 1e-3)) + open_ended

    return min(level, key=lambda score: (score.freedom, doubt(score)))


def more_specific(chosen: Score, others: Sequence[tuple[Score, Floats]]) -> Score:
    """An effect of a few channels that explains far more in them than the chosen one, or the chosen one.

    An effect of all channels with many parameters would explain a part of it, and the rest would look like
    another effect. If the effect of few channels goes first, nothing is lost.

    Args:
        chosen: the score that would be named.
        others: scores with what each is worth, (21,).
    """
    specific = []
    for score, worth in others:
        few = worth >= LEAST_CHANNEL_SHARE
        if score is chosen or score.freedom > chosen.freedom or not 0 < few.mean() <= FEW:
            continue
        own, its = (each.channel_share[:, few].mean(axis=1) for each in (score, chosen))
        if own.mean() >= MUCH_BETTER * its.mean() and difference_test(own - its)[1] <= FOLD_LEVEL:
            specific.append((float(worth[few].sum()), score))
    return max(specific, key=lambda found: found[0])[1] if specific else chosen


def could_replace(score: Score, other: Score) -> bool:
    """Whether another effect could replace a named one: the data do not tell the two apart.

    An example: materials are recorded one after another. Then a constant for each material also explains a
    drift. It explains more than the drift, because materials differ, but the drift is as likely.
    """
    # If an effect explains nothing alone, no other can be said to explain as much.
    if score.candidate.certain or score.share <= 0:
        return False
    contained = _much_simpler(other, score) and other.repeats <= FOLD_LEVEL
    return other.share >= (CONTAINED if contained else CONFOUNDED) * score.share


def _does_as_well(score: Score, best: Score) -> bool:
    """Whether an effect explains nearly as much as the best, or is much simpler and lacks little.

    An example: bumps all over the skin contain a constant and explain a little more. If the difference is
    not worth naming, the constant is the cause.
    """
    less = score.against(best)[1]
    if score.share >= AS_GOOD * best.share and less > FOLD_LEVEL:
        return True
    too_little = best.share - score.share < LEAST_SHARE and less > CLEARLY_LESS
    return _much_simpler(score, best) and too_little


def _much_simpler(score: Score, other: Score) -> bool:
    return score.freedom <= MUCH_SIMPLER * other.freedom

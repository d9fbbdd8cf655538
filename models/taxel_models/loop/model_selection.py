"""Which of several scores is taken: a form of one effect, or one of several causes."""

import math
from collections.abc import Sequence
from typing import Final

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel_models.loop.basis import Floats
from taxel_models.loop.cross_validation import Score, difference_test

FOLD_LEVEL: Final = 0.025
"""Of the t-test over folds: what a few blocks bring about may stand out and still not repeat."""

LEAST_SHARE: Final = 0.02
"""Of the residual's energy over all channels: less is not worth a new version."""

NEARLY: Final = 0.9
"""Of the most that any effect is worth: among those, the share decides, which tells causes apart better."""

AS_GOOD: Final = 0.985
"""Of the best share: a form with fewer figures that explains so much of it is taken instead."""

MUCH_SIMPLER: Final = 0.25
"""Of another's figures: of an effect with no more, less is asked."""

CLEARLY_LESS: Final = 0.005
"""Of the t-test over folds: a much simpler effect is taken in the best one's place if what it lacks is too
little to be named by itself, and no clear loss."""

LEAST_CHANNEL_SHARE: Final = 0.15
"""Of one channel's energy: a cause of few channels matters to them."""

FEW: Final = 1 / 3
MUCH_BETTER: Final = 1.5
"""A cause of at most so many of the channels that explains so many times as much in them goes first."""

CONFOUNDED: Final = 0.8
"""Of an effect's share: another that explains so much in its place cannot be told from it."""

CONTAINED: Final = 0.5
"""The same of a much simpler one, which the effect may hold in itself beside something else."""


def simplest(scores: Sequence[Score]) -> Score:
    """The best score, or one with fewer fitted figures that explains nearly as much."""
    best = max(scores, key=lambda score: score.share)
    near = [score for score in scores if score is best or score.share >= AS_GOOD * best.share > 0]
    return min(near, key=lambda score: (score.freedom, -score.share))


def steadiest(scores: Sequence[Score]) -> Score:
    """The simplest of the best forms; if it does not repeat over the folds, a much simpler one that does.

    A form with many figures may explain most on the whole and yet not everywhere.
    """
    best = simplest(scores)
    plain = [score for score in scores if score.repeats <= FOLD_LEVEL and _much_simpler(score, best)]
    return best if best.repeats <= FOLD_LEVEL or not plain else simplest(plain)


def worth_most(able: Sequence[tuple[float, Score]]) -> list[Score]:
    """Of scores and what they are worth over all channels, those that are worth nearly the most.

    And much simpler ones that explain more than the one that is: what bumps all over the skin, say,
    make of a turned frame is worth a little more in mean absolute error, and is no better explained.
    """
    most, top = max(able, key=lambda pair: pair[0])
    return [
        score
        for value, score in able
        if value >= NEARLY * most or (score.share > top.share and _much_simpler(score, top))
    ]


def likeliest(scores: Sequence[Score], scale: Floats) -> Score:
    """Of different causes the one that explains most; of those that do as well, the simplest.

    As well means nearly as much, and not less in every fold; of a much simpler one less is asked.
    Between two with as many weights stands their observations: what the data say for the better one, t²/2,
    and how alike the electrodes' weights are, since a common cause draws them from one distribution,
    and a narrow one leaves less to choose.

    Args:
        scale: (21,) what an error of each channel counts, 1/counts².
    """
    best = max(scores, key=lambda score: score.share)
    level = [score for score in scores if score is best or _does_as_well(score, best)]

    def doubt(score: Score) -> float:
        t = 0.0 if score is best else score.against(best)[0]
        electrodes = len(CHANNELS[ELECTRODE_COLUMNS])
        # How unlike they are is one figure more where the cause does not say it (Schwarz 1978).
        open_ended = math.log(electrodes) / 2 if score.candidate.alike is None else 0.0
        return t**2 / 2 + electrodes * math.log(max(score.unlikeness(scale), 1e-3)) + open_ended

    return min(level, key=lambda score: (score.freedom, doubt(score)))


def more_specific(chosen: Score, others: Sequence[tuple[Score, Floats]]) -> Score:
    """A cause of a few channels that explains far more in them than the chosen one, or else that one.

    What changes all channels, and has figures enough, takes up a part of it; what is left then looks
    like anything. The other way round nothing is lost.

    Args:
        others: with what each is worth by channel, (21,).
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


def could_stand_for(score: Score, other: Score) -> bool:
    """Whether another effect explains so much in a named one's place that the data do not tell them apart.

    A constant of each material, say, holds a drift in itself if materials were recorded in turn: it
    explains more, since materials differ as well, and the drift is no less likely for that.
    """
    # Where an effect explains nothing by itself, nothing can be said to explain as much.
    if score.candidate.certain or score.share <= 0:
        return False
    contained = _much_simpler(other, score) and other.repeats <= FOLD_LEVEL
    return other.share >= (CONTAINED if contained else CONFOUNDED) * score.share


def _does_as_well(score: Score, best: Score) -> bool:
    """Whether a cause explains nearly as much as the best, or is much simpler and leaves too little.

    Bumps all over the skin, say, hold a constant in themselves, and whatever else the recording has:
    where that is not worth naming, the constant is the cause.
    """
    less = score.against(best)[1]
    if score.share >= AS_GOOD * best.share and less > FOLD_LEVEL:
        return True
    too_little = best.share - score.share < LEAST_SHARE and less > CLEARLY_LESS
    return _much_simpler(score, best) and too_little


def _much_simpler(score: Score, other: Score) -> bool:
    return score.freedom <= MUCH_SIMPLER * other.freedom

"""Proof: what a score must show for its effect to be named, and which simpler one is named in its place."""

from collections.abc import Sequence

from taxel.channels import CHANNELS
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.score import Score


def stands(score: Score, beside_others: bool, constants: Constants) -> bool:
    """Whether an effect repeats over the held-out folds and removes enough to be named.

    Args:
        beside_others: something is named already; its form may not be quite right.
        constants: of the inference.
    """
    if score.t < constants.least_t(score.folds, score.chance):
        return False
    worth = float(score.worth.mean())
    if not score.effect.is_predictable:
        # The variance of 50 contacts is by chance one and a half times as large once in 100 times.
        more = score.gain.sum() >= (constants.usual_of_kind - 1.0) / 2.0 * score.usual.sum()
        return bool(more and is_worth_calibrating(score, constants))
    # A form that is not quite right leaves a little.
    share = max(constants.least_share, constants.least_channel_share if beside_others else 0.0)
    # The less an effect removes, the surer it must be.
    part = score.chance * min(1.0, worth / constants.clear_share)
    surer = score.t >= constants.least_t(score.folds, part)
    if score.effect.fits_nothing and not score.form.candidate.ages:
        # It has no weights that could take what another cause left, and needs no share. One that grows may:
        # it fits where other causes grow, too.
        return worth > 0 and (surer or not beside_others)
    if worth >= share and surer:
        return True
    if score.form.candidate.fitting.pooled:
        # What all channels share is not told by one of them.
        return False
    of_channels = score.form.candidate.fitting.few_channels or score.effect.is_of_one_channel
    if beside_others and not (of_channels or score.effect.is_constant):
        # It leaves more in one channel than in others.
        return False
    # A channel's mean scatters from finger to finger.
    stricter = beside_others or score.effect.is_constant
    least = max(constants.clear_share if stricter else constants.least_channel_share, constants.least_share)
    # Choosing among all channels has its price (Bonferroni).
    sure = score.channel_t >= constants.least_t(score.folds, score.chance / len(CHANNELS))
    return bool((score.weighed.changes & (score.worth >= least) & sure).any())


def is_worth_calibrating(score: Score, constants: Constants) -> bool:
    """Whether offsets of contacts, which only a calibration can tell, are much of the error."""
    return bool(score.worth.mean() >= constants.least_channel_share)


def most_of_simpler(score: Score, constants: Constants) -> float:
    """How many figures an effect has at most that is simpler; fewer than the other, in any case."""
    return min(constants.simpler * score.freedom, score.freedom - 1)


def simplest(best: Score, scores: Sequence[Score], constants: Constants) -> Score:
    """The likeliest of those simpler than the best that carry most of what it explains, or the best.

    One that explains more need only be a little simpler. Where one still simpler carries most of that,
    too, it is taken in its place.
    """
    least = 0.0
    while True:
        least = max(least, constants.alike * best.total_gain)
        simpler = [
            score
            for score in scores
            if score.effect.is_predictable
            and (score.total_gain > least or score.worth.mean() >= best.worth.mean())
            and (
                score.freedom <= most_of_simpler(best, constants)
                or (score.freedom < best.freedom and score.total_gain > best.total_gain)
            )
        ]
        if not simpler:
            return best
        best = max(simpler, key=lambda score: score.log_evidence)

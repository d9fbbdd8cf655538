"""Proof: what a score must show for its effect to be named, and which simpler one is named in its place."""

from collections.abc import Sequence

from scipy import stats

from taxel.channels import CHANNELS
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.score import Score


def stands(score: Score, beside_others: bool, constants: Constants) -> bool:
    """Whether an effect repeats over the held-out folds and removes enough to be named.

    Args:
        beside_others: something is named already; its form may not be quite right.
        constants: of the inference.
    """
    if score.t < constants.least_t:
        return False
    if not score.effect.is_predictable:
        return bool(score.worth.mean() >= constants.least_channel_share)
    if score.worth.mean() >= constants.least_share:
        return True
    if score.effect.fits_nothing and not beside_others:
        return bool(score.worth.mean() > 0)
    if score.form.candidate.fitting.pooled:
        # What all channels share is not told by one of them.
        return False
    # The t above weighs channels by what other folds show: chance does not choose a clear one.
    told = (score.worth >= constants.clear_share) & (score.channel_t >= constants.least_t)
    if not (beside_others or score.effect.is_constant):
        # A channel's mean scatters from finger to finger.
        sure = score.channel_t >= _least_channel_t(score, constants)
        told |= (score.worth >= constants.least_channel_share) & sure
    told &= score.weighed.changes & (score.worth >= constants.least_share)
    return bool(told.any())


def _least_channel_t(score: Score, constants: Constants) -> float:
    """The t that one of all channels must reach: choosing among them has its price (Bonferroni)."""
    freedom = max(len(score.gain) - 1, 1)
    chance = stats.t.sf(constants.least_t, freedom)
    return float(stats.t.isf(chance / len(CHANNELS), freedom))


def most_of_simpler(score: Score, constants: Constants) -> float:
    """How many figures an effect has at most that is simpler; fewer than the other, in any case."""
    return min(constants.simpler * score.freedom, score.freedom - 1)


def simplest(best: Score, scores: Sequence[Score], constants: Constants) -> Score:
    """The likeliest of those simpler than the best that carry most of what it explains, or the best.

    Where one still simpler carries most of that, too, it is taken in its place.
    """
    least = 0.0
    while True:
        least = max(least, constants.alike * best.total_gain)
        simpler = [
            score
            for score in scores
            if score.effect.is_predictable
            and score.freedom <= most_of_simpler(best, constants)
            and score.total_gain > least
        ]
        if not simpler:
            return best
        best = max(simpler, key=lambda score: score.log_evidence)

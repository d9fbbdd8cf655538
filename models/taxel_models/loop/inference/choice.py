"""The choice: which of the effects that prove themselves is named next."""

from collections.abc import Sequence

from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.proof import simplest
from taxel_models.loop.inference.score import Score


def choose(able: Sequence[Score], untried: Sequence[Score], constants: Constants) -> Score | None:
    """The likeliest effect that proves itself, or a simpler one that carries most of it.

    Where it is in doubt, a constant of each channel may still prove itself.

    Args:
        able: those that prove themselves, the likeliest first.
        untried: those that were not named before, whether they prove themselves or not.
        constants: of the inference.
    """
    certain = next((score for score in able if score.form.candidate.certain), None)
    if certain or not able:
        return certain
    best = able[0]
    if best.effect.is_constant:
        # All others stand beside a constant and are likelier than it is alone, but for changes of few
        # channels. Their gain is on another scale, so that it does not say which of the two is simpler.
        return best
    constant = next((score for score in able if score.effect.is_constant), None)
    if any(casts_doubt(other, best, constants) for other in untried):
        return constant
    if not best.effect.is_predictable:
        # Offsets of contacts contain whatever is steady within them.
        steady = next((score for score in able if score.effect.is_steady), None)
        if steady is None and any(_is_steady_and_carries(other, best, constants) for other in untried):
            return choose(able[1:], untried, constants)
        return steady or best
    best = _simplest(best, able, constants)
    return constant if constant and _is_mostly(constant, best, constants) else best


def casts_doubt(other: Score, best: Score, constants: Constants) -> bool:
    """Whether a likelier effect, about as simple, does not repeat: the best may only stand for it.

    One that takes nothing off the error of held-out folds is no better explanation.
    """
    if best.form.candidate.fitting.few_channels:
        # Others take correlated channels for independent witnesses.
        return False
    likelier = other is not best and other.log_evidence > best.log_evidence
    simple = constants.simpler * other.freedom <= best.freedom
    # What the model's own residual has, too, is no doubt about another cause.
    repeats = other.t_with_usual >= constants.least_t(other.folds)
    return likelier and simple and not repeats and bool(other.worth.mean() > 0)


def _is_steady_and_carries(other: Score, best: Score, constants: Constants) -> bool:
    """Whether an effect that is steady within contacts removes most of what their offsets do.

    It need not be proven: it may be what the model has, too, and offsets of contacts only contain it.
    """
    most = constants.alike * float(best.worth.mean())
    return other.effect.is_steady and float(other.worth.mean()) >= most


def _is_mostly(constant: Score, best: Score, constants: Constants) -> bool:
    """Whether more than half of what the best one finds is the constant's that stands beside it.

    It is not where the best one tells that with fewer figures and is likelier without a constant.
    """
    if not best.needs_constant or 2 * constant.log_evidence <= best.log_evidence:
        return False
    fewer = best.freedom <= constants.simpler * constant.freedom
    return not fewer or best.log_evidence_alone <= constant.log_evidence


def _simplest(best: Score, able: Sequence[Score], constants: Constants) -> Score:
    """The best one, or a simpler one that carries most of it.

    Where the best one has a form as simple and likelier, it is as simple itself. A change of few channels
    has few figures already, and its gain is not on the scale of the others. A constant is judged by itself,
    and all others beside one.
    """
    if best.form.candidate.fitting.few_channels:
        return best
    simpler = [
        score
        for score in able
        if not score.effect.is_constant
        and score.evidence_within(score.freedom) > best.evidence_within(score.freedom)
    ]
    return simplest(best, simpler, constants)

"""How much of a gain few blocks or contacts leave open."""

from typing import Final

import numpy as np
from scipy import stats

from taxel_models.evaluation.standard_error import corrected_standard_error
from taxel_models.loop.basis import Floats

RECORDED: Final = 8
"""Contacts of another recording."""


def gain_limit(seen: Floats, unseen: Floats, confidence: float) -> Floats:
    """(k,) the limit of gains by fold (folds, k).

    Bins that weights are fitted to say too much, held-out bins say as much too little (Akaike 1974).
    The mean of both matters where a cause has many weights and there are few blocks for each, such
    as kinds of a covariate. A limit over folds is added: the fewer blocks there are, the less they can
    rule out.

    Args:
        seen: of weights that are fitted to all folds.
        unseen: of weights that are fitted to the other folds.
        confidence: of the limit; 0.5 for the mean itself.
    """
    folds = len(seen)
    error = np.array([corrected_standard_error(folds * own, 1.0 / (folds - 1)) for own in seen.T])
    own = np.maximum(0.5 * (seen + unseen).sum(axis=0), 0.0)
    return np.asarray(own + float(stats.t.ppf(confidence, folds - 1)) * error)


def times_for_few(contacts: int, confidence: float) -> float:
    """How many times more another recording may show than if all contacts were known.

    Both are chances of a mean square of normal values: over that of a few others it has Fisher's F, over
    the true one a chi-squared distribution.

    Args:
        contacts: that are known.
        confidence: that a recording of `RECORDED` contacts shows no more.
    """
    of_all = stats.chi2.ppf(confidence, RECORDED) / RECORDED
    return float(stats.f.ppf(confidence, RECORDED, contacts) / of_all)

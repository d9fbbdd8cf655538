"""How much of a gain few blocks or contacts leave open."""

from typing import Final

import numpy as np
from scipy import stats

from taxel_models.evaluation.standard_error import corrected_standard_error
from taxel_models.loop.basis import Floats

RECORDED: Final = 8
"""Contacts that another recording is taken to have."""


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


def times_for_few(freedom: int, confidence: float) -> float:
    """How many times more a recording may show if few contacts are known than if all were known.

    Offsets of contacts are taken as normal. The mean square of `RECORDED` of them, over that of the known
    contacts, has Fisher's F distribution; over the true one, it has a chi-squared distribution, divided by
    `RECORDED`. The result is the quantile of the first over that of the second.

    Args:
        freedom: degrees of freedom of the known contacts.
        confidence: that a recording shows no more.
    """
    of_all = stats.chi2.ppf(confidence, RECORDED) / RECORDED
    return float(stats.f.ppf(confidence, RECORDED, freedom) / of_all)

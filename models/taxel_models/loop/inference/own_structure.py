"""What each effect explains of a model's own held-out residual."""

from dataclasses import replace

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from taxel.channels import CHANNELS
from taxel_models.evaluation.standard_error import corrected_standard_error
from taxel_models.loop.basis import Floats
from taxel_models.loop.inference.evidence import Products, held_out
from taxel_models.loop.inference.score import Score
from taxel_models.loop.inference.scoring import Scoring


def structure_of(scoring: Scoring) -> dict[str, tuple[Floats, Floats]]:
    """For each effect alone, its log odds (21,) and its gain (21,), counts², for each bin."""
    with threadpool_limits(1):
        scores = scoring.scores([])
        return {
            score.name: (
                np.maximum(score.weighed.by_channel, 0.0) / len(scoring.bins),
                np.maximum(own_gain(scoring, score), 0.0) / len(scoring.bins),
            )
            for score in scores
        }


def own_gain(scoring: Scoring, score: Score) -> Floats:
    """(21,) what an effect takes off the squared error in every channel, counts².

    Bins that weights are fitted to say too much, held-out bins say as much too little (Akaike 1974).
    The mean of both matters where a cause has many weights and there are few blocks for each, such
    as kinds of a covariate. The 95 % limit of the mean share over folds is added: the fewer blocks
    the reference has, the less it can rule out.
    """
    if not score.effect.is_predictable:
        return score.taken_off
    bases = scoring.bases([])
    products = Products.of(bases.beside, score.form.design)
    if score.effect.is_constant:
        products = replace(products, base=bases.plain)
    fitting = score.form.candidate.fitting
    included = np.ones(len(CHANNELS)) if fitting.allowed is None else fitting.allowed.astype(np.float64)
    every = replace(score.weighed, included=included)
    folds = [held_out(products, fitting, every, seen=seen) for seen in (True, False)]
    seen, unseen = (tested.gain * tested.noise for tested in folds)
    energy = np.maximum((folds[0].before * folds[0].noise).sum(axis=0), 1e-9)
    by_fold = products.folds * (seen / energy).mean(axis=1)
    error = corrected_standard_error(by_fold, 1.0 / (products.folds - 1))
    open_share = float(stats.t.ppf(0.95, products.folds - 1)) * error
    own = np.maximum(0.5 * (seen + unseen).sum(axis=0), 0.0)
    return np.asarray((own + open_share * energy) * scoring.whitening.scale**2)

"""Worth: what an effect takes off the error of held-out bins, in counts.

Evidence and the test over folds count whitened errors: how sure an effect is. They say little of what it
is worth. An error that lasts for a whole contact is one of few independent errors, and yet it is most of
what a model gets wrong there.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Fitting
from taxel_models.loop.inference.evidence import Weighed, weights_by_fold
from taxel_models.loop.inference.products import Products


def held_out_error(
    products: Products, fitting: Fitting, weighed: Weighed, coloured: Callable[[Floats], Floats]
) -> tuple[Floats, Floats]:
    """(21,) the squared error of all bins without a form and with it, by weights of the other folds.

    Args:
        products: of a base and the form.
        fitting: of the form.
        weighed: its evidence.
        coloured: gives (21, bins) errors of whitened ones (21, bins).
    """
    base = products.base
    alone, beside, weights = weights_by_fold(products, fitting, weighed)
    served = np.arange(alone.shape[-1]) >= base.not_served
    alone, beside = alone * served, beside * served
    before, after = base.target.values[:, :, 0].copy(), base.target.values[:, :, 0].copy()
    edges = np.searchsorted(base.target.fold, np.arange(products.folds + 1))
    for fold, (start, stop) in enumerate(pairwise(edges)):
        rows = slice(start, stop)
        regressors = base.design.values[:, rows]
        before[:, rows] -= (regressors @ alone[fold][:, :, None])[..., 0]
        after[:, rows] -= (regressors @ beside[fold][:, :, None])[..., 0]
        after[:, rows] -= (products.design.values[:, rows] @ weights[fold][:, :, None])[..., 0]
    return (coloured(before) ** 2).sum(axis=1), (coloured(after) ** 2).sum(axis=1)

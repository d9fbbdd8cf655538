"""What a model would get wrong on kinds that its training never had, such as other materials.

The model has seen all kinds of its recordings. Small trees stand in for it: each row is predicted by some
that were fitted to rows of other kinds.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from taxel.scaling import Scaler
from taxel_models.loop.observations import Observations

GROUPS: Final = 4
"""Kinds are left out a quarter at a time."""

TREES: Final = 40

SMALL: Final = {
    "multi_strategy": "multi_output_tree",
    "tree_method": "hist",
    "eta": 0.2,
    "max_depth": 6,
    "min_child_weight": 20,
    "max_bin": 128,
    # The sums of a tree depend on the number of threads.
    "nthread": 1,
}


def without_their_kind(observations: Observations, column: str) -> Observations:
    """The same rows, each predicted by trees that never saw its kind.

    Args:
        column: that names at least two kinds.
    """
    # `taxel[loop]` alone has no XGBoost, and needs it only where a model is exported.
    import xgboost

    values, windows = observations.covariates[column], observations.windows
    kinds = np.random.default_rng(0).permutation(np.unique(values))
    predicted = np.zeros_like(observations.measured)
    for group in np.array_split(kinds, min(GROUPS, len(kinds))):
        left_out = np.isin(values, group)
        targets = Scaler.fit(observations.measured[~left_out])
        train = xgboost.QuantileDMatrix(
            windows[~left_out],
            targets.normalise(observations.measured[~left_out].astype(np.float32)),
            max_bin=SMALL["max_bin"],
            nthread=SMALL["nthread"],
        )
        trees = xgboost.train(SMALL, train, TREES)
        predicted[left_out] = targets.restore(trees.inplace_predict(windows[left_out]))
    return replace(observations, predicted=predicted, base=predicted, _history={})

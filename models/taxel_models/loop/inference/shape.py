"""Whether a channel's change is in proportion to its signal, or added whatever the signal is."""

import numpy as np

from taxel.channels import COUNTS_MAX
from taxel_models.loop.basis import Floats, Shared
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.inference.whitening import Bins

_ROUNDS = 4
"""Fits, each by the rows that the one before kept within the limits of counts."""


def is_added(candidate: Candidate, channel: int, measured: Floats, left: Floats, bins: Bins) -> bool:
    """Whether counts with the same course explain a channel better than a gain does.

    Counts that are taken from a tared channel end at 0. To a fit that does not know this limit they look
    like a loss of sensitivity, since nothing is missing in free air. Both are fitted within the limits. The
    model may have absorbed the gain's mean.

    Args:
        candidate: a gain, whose regressors are the signal times a course. No other form is added.
        channel: that may have it.
        measured: (n, 21) counts.
        left: (n, 21) what no named effect explains of them, counts.
        bins: of the fit part.
    """
    basis, rows = candidate.basis, bins.order
    if not isinstance(basis, Shared) or basis.shape is None:
        return False
    counts, error = measured[rows, channel], left[rows, channel]
    signal, course = basis.shape[rows, channel, None], basis.features[rows]
    about_rest, about_mean, added = (
        _squared_error(regressors, counts, counts - error)
        for regressors in (signal * course, (signal - signal.mean()) * course, course)
    )
    return added < min(about_rest, about_mean)


def _squared_error(regressors: Floats, measured: Floats, predicted: Floats) -> float:
    """Of the best weights of the regressors (n, k), within the limits of counts."""
    within = np.ones(len(measured), np.bool_)
    found = predicted
    for _ in range(_ROUNDS):
        weights = np.linalg.lstsq(regressors[within], (measured - predicted)[within], rcond=None)[0]
        found = predicted + regressors @ weights
        within = (found > 0) & (found < COUNTS_MAX)
    return float(((measured - np.clip(found, 0, COUNTS_MAX)) ** 2).sum())

"""Whether a channel's change is in proportion to its signal, or added whatever the signal is."""

import numpy as np

from taxel_models.loop.basis import Floats, Shared
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.inference.whitening import Bins
from taxel_models.loop.limits import Limits


def is_added(candidate: Candidate, channel: int, measured: Floats, left: Floats, bins: Bins) -> bool:
    """Whether counts with the same course explain a channel better than a gain or a leak does.

    Counts that are taken from a tared channel end at 0. To a fit that does not know this limit they look
    like a loss of sensitivity, since nothing is missing in free air. Both are fitted within the limits. The
    model may have absorbed the gain's mean.

    Args:
        candidate: a gain, whose regressors are the signal times a course, or a leak, which has none.
        channel: that may have it.
        measured: (n, 21) counts.
        left: (n, 21) what no named effect explains of them, counts.
        bins: of the fit part.
    """
    basis, rows = candidate.basis, bins.order
    if isinstance(basis, Shared) and basis.shape is not None:
        signal, course = basis.shape[rows, channel, None], basis.features[rows]
    else:
        signal = basis.at(rows)[channel]
        course = np.ones_like(signal)
    limits = Limits.of(measured)
    counts, error = measured[rows, channel], left[rows, channel]

    def squared_error(regressors: Floats) -> float:
        weights = limits.fitted(channel, regressors, counts, counts - error)
        found = counts - error + regressors @ weights
        return float(((counts - np.clip(found, limits.low[channel], limits.high[channel])) ** 2).sum())

    about_mean = (signal - signal.mean()) * course
    in_proportion = min(squared_error(signal * course), squared_error(about_mean))
    if course.shape[1] > 1:
        # The model absorbs the mean of a gain that ages as a constant, which no factor of the signal is.
        constant = np.ones_like(signal)
        nothing, alone = squared_error(0.0 * constant), squared_error(constant)
        beside = squared_error(np.hstack([constant, signal * course]))
        # What the constant explains alone would be explained with any other cause beside it, too.
        if nothing - alone < alone - beside:
            in_proportion = min(in_proportion, beside)
    return squared_error(course) < in_proportion

"""Whether a channel's change is in proportion to its signal, or added, or begins at a level of it."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from taxel_models.loop.basis import Floats, Shared
from taxel_models.loop.effects.effect import Candidate
from taxel_models.loop.inference.whitening import Bins
from taxel_models.loop.limits import Limits


@dataclass(frozen=True)
class _Rows:
    """The rows of the fit part in one channel.

    Attributes:
        counts: (n,) measured.
        error: (n,) of them that no named effect explains, counts.
        limits: of the counts of all channels.
    """

    channel: int
    counts: Floats
    error: Floats
    limits: Limits

    @classmethod
    def of(cls, channel: int, measured: Floats, left: Floats, bins: Bins) -> Self:
        """Of all rows and channels (n, 21)."""
        rows = bins.order
        return cls(channel, measured[rows, channel], left[rows, channel], Limits.of(measured))

    def fitted(self, regressors: Floats) -> tuple[float, Floats]:
        """The squared error with regressors (n, k) within the limits, and their weights (k,)."""
        without = self.counts - self.error
        weights = self.limits.fitted(self.channel, regressors, self.counts, without)
        low, high = self.limits.low[self.channel], self.limits.high[self.channel]
        found = np.clip(without + regressors @ weights, low, high)
        return float(((self.counts - found) ** 2).sum()), weights

    def squared_error(self, regressors: Floats) -> float:
        """With regressors (n, k)."""
        return self.fitted(regressors)[0]


def _signal_and_course(candidate: Candidate, channel: int, bins: Bins) -> tuple[Floats, Floats]:
    """(n, 1) the signal that a gain or a leak follows, and (n, k) how that changes with time."""
    basis, rows = candidate.basis, bins.order
    if isinstance(basis, Shared) and basis.shape is not None:
        return basis.shape[rows, channel, None], basis.features[rows]
    signal = basis.at(rows)[channel]
    return signal, np.ones_like(signal)


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
    signal, course = _signal_and_course(candidate, channel, bins)
    rows = _Rows.of(channel, measured, left, bins)
    about_mean = (signal - signal.mean()) * course
    in_proportion = min(rows.squared_error(signal * course), rows.squared_error(about_mean))
    if course.shape[1] > 1:
        # The model absorbs the mean of a gain that ages as a constant, which no factor of the signal is.
        constant = np.ones_like(signal)
        nothing, alone = rows.squared_error(0.0 * constant), rows.squared_error(constant)
        beside = rows.squared_error(np.hstack([constant, signal * course]))
        # What the constant explains alone would be explained with any other cause beside it, too.
        if nothing - alone < alone - beside:
            in_proportion = min(in_proportion, beside)
    return rows.squared_error(course) < in_proportion


def is_bent(
    candidate: Candidate, channel: int, bends: Iterable[Floats], measured: Floats, left: Floats, bins: Bins
) -> bool:
    """Whether a saturation explains a channel better than a gain does, each beside a constant.

    A line through a bent signal is too flat, as a loss of sensitivity is.

    Args:
        bends: what saturations from several levels on add, each (n, 21).
        others: as of `is_added`.
    """
    signal, course = _signal_and_course(candidate, channel, bins)
    rows = _Rows.of(channel, measured, left, bins)
    constant = np.ones_like(signal)
    in_proportion = rows.squared_error(np.hstack([constant, signal * course]))
    for bend in bends:
        bent, weights = rows.fitted(np.hstack([constant, bend[bins.order, channel, None]]))
        if bent < in_proportion and weights[1] > 0:
            return True
    return False

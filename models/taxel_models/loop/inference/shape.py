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
class Shape:
    """A channel that may have a gain or a leak, in the rows of the fit part.

    Attributes:
        channel: its number.
        signal: (n, 1) what the gain or the leak follows.
        course: (n, k) how much of it, by time; a leak's is constant.
        counts: (n,) measured.
        error: (n,) of them that no named effect explains, counts.
        limits: of the counts of all channels.
    """

    channel: int
    signal: Floats
    course: Floats
    counts: Floats
    error: Floats
    limits: Limits

    @classmethod
    def of(cls, candidate: Candidate, channel: int, measured: Floats, left: Floats, bins: Bins) -> Self:
        """Of all rows and channels.

        Args:
            candidate: a gain, whose regressors are the signal times a course, or a leak.
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
        counts, error = measured[rows, channel], left[rows, channel]
        return cls(channel, signal, course, counts, error, Limits.of(measured))

    @property
    def is_added(self) -> bool:
        """Whether counts with the same course explain the channel better than the gain or the leak does.

        Counts that are taken from a tared channel end at 0. To a fit that does not know this limit they
        look like a loss of sensitivity, since nothing is missing in free air. Both are fitted within the
        limits. The model may have absorbed the gain's mean.
        """
        followed = self.signal * self.course
        about_mean = (self.signal - self.signal.mean()) * self.course
        in_proportion = min(self._squared_error(followed), self._squared_error(about_mean))
        if self.course.shape[1] > 1:
            # The model absorbs the mean of a gain that ages as a constant, no factor of the signal.
            constant = np.ones_like(self.signal)
            nothing, alone = self._squared_error(0.0 * constant), self._squared_error(constant)
            beside = self._squared_error(np.hstack([constant, followed]))
            # What the constant explains alone would be explained with any other cause beside it, too.
            if nothing - alone < alone - beside:
                in_proportion = min(in_proportion, beside)
        return self._squared_error(self.course) < in_proportion

    def is_bent(self, bends: Iterable[Floats]) -> bool:
        """Whether a saturation explains the channel better than the gain does, each beside a constant.

        A line through a bent signal is too flat, as a loss of sensitivity is.

        Args:
            bends: (n,) each, what a saturation adds from a level on.
        """
        constant = np.ones_like(self.signal)
        in_proportion = self._squared_error(np.hstack([constant, self.signal * self.course]))
        for bend in bends:
            bent, weights = self._fitted(np.column_stack([constant, bend]))
            if bent < in_proportion and weights[1] > 0:
                return True
        return False

    def _squared_error(self, regressors: Floats) -> float:
        """With regressors (n, k), within the limits."""
        return self._fitted(regressors)[0]

    def _fitted(self, regressors: Floats) -> tuple[float, Floats]:
        """The squared error with regressors (n, k) within the limits, and their weights (k,)."""
        without = self.counts - self.error
        weights = self.limits.fitted(self.channel, regressors, self.counts, without)
        low, high = self.limits.low[self.channel], self.limits.high[self.channel]
        found = np.clip(without + regressors @ weights, low, high)
        return float(((self.counts - found) ** 2).sum()), weights

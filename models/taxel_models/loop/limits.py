"""The limits of counts: a channel that is at one does not tell how far beyond it would be.

The counts of a tared channel end at 0 in free air. What is taken from them shows only while it is pressed.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from taxel.channels import COUNTS_MAX
from taxel_models.loop.basis import Floats

_ROUNDS = 8
"""Fits, each by the rows that the one before kept within the limits."""


@dataclass(frozen=True)
class Limits:
    """What channels show at least and at most.

    Attributes:
        low: (21,) counts; 0, or minus infinity for a channel that was below.
        high: (21,) counts; 4095, or infinity for a channel that was above.
    """

    low: Floats
    high: Floats

    @classmethod
    def of(cls, measured: Floats) -> Self:
        """Of channels that showed these counts (n, 21)."""
        low = np.where(measured.min(axis=0) < 0, -np.inf, 0.0)
        return cls(low, np.where(measured.max(axis=0) > COUNTS_MAX, np.inf, float(COUNTS_MAX)))

    def shown(self, counts: Floats) -> Floats:
        """(n, 21) counts as channels show them."""
        return np.clip(counts, self.low, self.high)

    def beyond(self, measured: Floats, predicted: Floats) -> Floats:
        """(n, 21) how far predictions lead beyond a limit where a channel is at it, 0 elsewhere, counts."""
        below = np.where(measured <= self.low, np.minimum(predicted - self.low, 0.0), 0.0)
        above = np.where(measured >= self.high, np.maximum(predicted - self.high, 0.0), 0.0)
        return np.asarray(below + above)

    def fitted(self, channel: int, regressors: Floats, measured: Floats, predicted: Floats) -> Floats:
        """(k,) weights of regressors (n, k) that bring a channel's predictions (n,) nearest to its own."""
        low, high = self.low[channel], self.high[channel]
        kept = np.ones(len(measured), np.bool_)
        for _ in range(_ROUNDS):
            rows = regressors[kept], (measured - predicted)[kept]
            weights = np.asarray(np.linalg.lstsq(*rows, rcond=None)[0])
            found = predicted + regressors @ weights
            kept = (found > low) & (found < high)
        return weights

    def share_of_constants(self, measured: Floats, predicted: Floats) -> Floats:
        """(n, 21) the share that channels show of the constants that explain them best.

        Args:
            measured: (n, 21) counts.
            predicted: (n, 21) counts, without the constants.
        """
        left, constants = measured - predicted, np.zeros(len(self.low))
        kept = np.ones(left.shape, np.bool_)
        for _ in range(_ROUNDS):
            constants = np.where(kept, left, 0.0).sum(axis=0) / np.maximum(kept.sum(axis=0), 1)
            found = predicted + constants
            before, kept = kept, (found > self.low) & (found < self.high)
            if (kept == before).all():
                break
        first, last = (self.shown(counts) for counts in (predicted, predicted + constants))
        share = np.ones_like(left)
        # Elsewhere it is exactly 1.
        at_limit = (first != predicted) | (last != predicted + constants)
        np.divide(last - first, constants, out=share, where=at_limit & (np.abs(constants) > 1e-9))
        return share

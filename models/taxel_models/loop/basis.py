"""Regressors of a residual: their weighted sum is what a candidate adds to each channel."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


class Basis(Protocol):
    """k regressors, the same for every channel or each channel's own."""

    @property
    def size(self) -> int:
        """k."""

    def at(self, rows: Rows) -> Floats:
        """(1 or 21, m, k) regressors at some rows."""

    def times(self, weights: Floats) -> Floats:
        """(n, 21) of weights (21, k)."""


@dataclass(frozen=True)
class Shared:
    """Regressors (n, k) that are the same for every channel, or scaled by a shape (n, 21)."""

    features: Floats
    shape: Floats | None = None

    @property
    def size(self) -> int:
        """k."""
        return int(self.features.shape[1])

    def at(self, rows: Rows) -> Floats:
        """(1 or 21, m, k) regressors."""
        features = self.features[rows]
        if self.shape is None:
            return features[None]
        return np.asarray(self.shape[rows].T[:, :, None] * features[None])

    def times(self, weights: Floats) -> Floats:
        """(n, 21) of weights (21, k)."""
        products = self.features @ weights.T
        return products if self.shape is None else products * self.shape


@dataclass(frozen=True)
class Own:
    """Regressors (n, 21, k), each channel's own."""

    values: NDArray[np.float32]

    @property
    def size(self) -> int:
        """k."""
        return int(self.values.shape[2])

    def at(self, rows: Rows) -> Floats:
        """(21, m, k) regressors."""
        return np.asarray(self.values[rows].transpose(1, 0, 2), dtype=np.float64)

    def times(self, weights: Floats) -> Floats:
        """(n, 21) of weights (21, k)."""
        return np.asarray(np.einsum("nck,ck->nc", self.values, weights))


@dataclass(frozen=True)
class Joined:
    """The regressors of two bases together."""

    first: Basis
    second: Basis

    @property
    def size(self) -> int:
        """k."""
        return self.first.size + self.second.size

    def at(self, rows: Rows) -> Floats:
        """(21, m, k) regressors."""
        first, second = self.first.at(rows), self.second.at(rows)
        channels = max(len(first), len(second))
        both = [np.broadcast_to(values, (channels, *values.shape[1:])) for values in (first, second)]
        return np.concatenate(both, axis=2)

    def times(self, weights: Floats) -> Floats:
        """(n, 21) of weights (21, k)."""
        size = self.first.size
        return self.first.times(weights[:, :size]) + self.second.times(weights[:, size:])


def broadcast(weights: Floats, size: int) -> Floats:
    """(21, k) of weights (k,) that all channels have in common."""
    return np.broadcast_to(weights, (len(CHANNELS), size)).copy()


@dataclass(frozen=True)
class AboutMean:
    """Another basis, less the mean of each regressor.

    A trained model has absorbed what an effect adds on average, so what is left of it has the mean 0.

    Attributes:
        basis: the other one.
        means: (1 or 21, k).
    """

    basis: Basis
    means: Floats

    @property
    def size(self) -> int:
        """k."""
        return self.basis.size

    def at(self, rows: Rows) -> Floats:
        """(1 or 21, m, k) regressors."""
        return np.asarray(self.basis.at(rows) - self.means[:, None, :])

    def times(self, weights: Floats) -> Floats:
        """(n, 21) of weights (21, k)."""
        return np.asarray(self.basis.times(weights) - self.constants(weights))

    def constants(self, weights: Floats) -> Floats:
        """(21,) what is taken from each channel for weights (21, k)."""
        return np.asarray((self.means * weights).sum(axis=1))

"""Whitening: rows become bins of uncorrelated noise of equal size, channel by channel.

A model's residual is correlated in time: a channel errs alike for a whole contact, and neighbouring rows
err alike. Taken as independent, such rows would make evidence out of nothing. The noise of the bins of a
block has three parts: one that the whole block shares, one that fades (Ornstein-Uhlenbeck), and a white
one.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.held_out_residual import CorrelatedResidual, HeldOutResidual
from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Basis, Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.running_mean import mean_within

ROUNDING: Final = 12**-0.5
"""Standard deviation of rounding to whole counts."""

_SHARES: Final = np.linspace(0.0, 0.9, 10)
_LEAST_WHITE: Final = 0.05
_MOST_BINS: Final = 6_000
"""More rows make longer bins."""


@dataclass(frozen=True)
class NoiseShape:
    """The parts of a channel's noise, as shares of its variance; the rest is white.

    Attributes:
        shared: (21,) of the whole block.
        fading: (21,) of bins near each other in time.
    """

    shared: Floats
    fading: Floats

    @classmethod
    def usual(cls) -> Self:
        """A guess, for a model whose own held-out residual is not known."""
        return cls(np.full(len(CHANNELS), 0.3), np.full(len(CHANNELS), 0.5))

    @classmethod
    def kept(cls, known: HeldOutResidual | CorrelatedResidual) -> Self:
        """As a manifest keeps it."""
        return cls(np.array(known.shared), np.array(known.fading))

    @classmethod
    def of(cls, bins: "Bins", residual: Floats, fading_s: float) -> Self:
        """The likeliest shape of a residual (n, 21), channel by channel."""
        values = bins.means(residual[None])[0]
        counts = {block.stop - block.start for block in bins.blocks}
        best = np.full(len(CHANNELS), -np.inf)
        shared, fading = np.zeros(len(CHANNELS)), np.zeros(len(CHANNELS))
        for first in _SHARES:
            for second in _SHARES:
                if first + second > 1.0 - _LEAST_WHITE + 1e-9:
                    continue
                likelihood = np.zeros(len(CHANNELS))
                squares = np.zeros(len(CHANNELS))
                factors = {
                    count: np.linalg.cholesky(covariance(count, first, second, bins.seconds / fading_s))
                    for count in counts
                }
                for rows in bins.blocks:
                    factor = factors[rows.stop - rows.start]
                    white = np.linalg.solve(factor, values[rows])
                    squares += (white**2).sum(axis=0)
                    likelihood -= np.log(np.diag(factor)).sum()
                likelihood -= 0.5 * len(values) * np.log(np.maximum(squares, 1e-12))
                better = likelihood > best
                best[better] = likelihood[better]
                shared[better], fading[better] = first, second
        return cls(shared, fading)


def covariance(count: int, shared: float, fading: float, step: float) -> Floats:
    """(count, count) of the noise of neighbouring bins, of variance 1; a step in fading times."""
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) * step
    white = (1.0 - shared - fading) * np.eye(count)
    return np.asarray(shared + fading * np.exp(-apart) + white)


@dataclass(frozen=True)
class Bins:
    """Rows of the fit part, a few neighbours to a bin; bins are ordered by fold and block.

    Attributes:
        order: (m,) rows in the order of their bins.
        starts: (bins,) first place of each bin in `order`.
        blocks: the bins of each block, in time.
        fold: (bins,) of the cross-validation.
        rows_each: about how many rows a bin has.
    """

    order: NDArray[np.int64]
    starts: NDArray[np.int64]
    blocks: tuple[slice, ...]
    fold: NDArray[np.int64]
    rows_each: int

    @classmethod
    def of(cls, blocks: Blocks, bin_s: float) -> Self:
        """Of the fit part's rows."""
        wanted = np.flatnonzero(blocks.fold >= 0)
        wanted = wanted[np.argsort(blocks.fold[wanted], kind="stable")]
        rows_each = max(round(bin_s / TICK_S), -(-int(blocks.fit.sum()) // _MOST_BINS))
        by_block = np.argsort(blocks.of_row, kind="stable")
        edges = np.searchsorted(blocks.of_row[by_block], np.arange(len(blocks) + 1))
        order, starts, members, fold = [], [], [], []
        place = number = 0
        for block in wanted:
            rows = by_block[edges[block] : edges[block + 1]]
            if not len(rows):
                continue
            count = max(1, len(rows) // rows_each)
            order.append(rows)
            starts.append(place + np.arange(count) * len(rows) // count)
            members.append(slice(number, number + count))
            fold.append(np.full(count, blocks.fold[block]))
            place, number = place + len(rows), number + count
        joined = (np.concatenate(parts) for parts in (order, starts, fold))
        rows, firsts, folds = joined
        return cls(rows, firsts, tuple(members), folds, rows_each)

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def seconds(self) -> float:
        """From one bin to the next."""
        return self.rows_each * TICK_S

    @property
    def folds(self) -> int:
        """That effects are tested on."""
        return int(self.fold.max()) + 1

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """(bins,) rows of each bin."""
        return np.diff(self.starts, append=len(self.order))

    def means(self, values: Floats) -> Floats:
        """(c, bins, k) means of values (c, n, k) over the rows of each bin."""
        return self._means_in_order(values[:, self.order])

    def fast(self, means: Floats, window_s: float) -> Floats:
        """(c, bins, k) of means (c, bins, k), what is left of them less their average over a window."""
        window = 2 * round(0.5 * window_s / self.seconds) + 1
        return np.asarray(means - mean_within(means, window, self.blocks))

    def of_basis(self, basis: Basis) -> Floats:
        """(1 or 21, bins, k) means of a basis."""
        return self._means_in_order(basis.at(self.order))

    def _means_in_order(self, values: Floats) -> Floats:
        """(c, bins, k) of values (c, rows, k) at the rows in `order`."""
        return np.asarray(np.add.reduceat(values, self.starts, axis=1) / self.sizes[None, :, None])


class Whitening:
    """Makes the noise of bins white and, over the channel's scale, of size 1.

    A block that errs far more than most counts less, channel by channel (Huber 1964).

    Args:
        bins: that are whitened.
        shape: of the noise.
        residual: (n, 21) counts.
        constants: of the inference.
        rounding: standard deviation of what rounding leaves of the residual.

    Attributes:
        scale: (21,) standard deviation of a channel's residual, counts; at least that of rounding.
        quantum: (21,) squared, what rounding to whole counts leaves, over the scale.
    """

    def __init__(
        self,
        bins: Bins,
        shape: NoiseShape,
        residual: Floats,
        constants: Constants,
        rounding: Floats | float = ROUNDING,
    ) -> None:
        self.bins = bins
        self._shape = shape
        self._step = bins.seconds / constants.fading_s
        self._known: dict[int, tuple[Floats, Floats]] = {}
        self._counts = np.ones((len(CHANNELS), len(bins)))
        self.scale = np.maximum(residual[bins.order].std(axis=0), rounding)
        self.quantum = (rounding / self.scale) ** 2
        white = self(bins.means(residual.T[:, :, None]))[:, :, 0]
        size = np.array([np.sqrt((white[:, block] ** 2).mean(axis=1)) for block in bins.blocks])
        # Errors below rounding are none: a constant channel that is predicted exactly counts as well.
        most = constants.robust * np.maximum(np.median(size, axis=0), np.sqrt(self.quantum))
        for number, block in enumerate(bins.blocks):
            self._counts[:, block] = np.minimum(1.0, most / np.maximum(size[number], 1e-12))[:, None]

    def coloured(self, white: Floats) -> Floats:
        """(21, bins) errors, counts, of whitened ones (21, bins); blocks count as much as they do there."""
        errors = np.empty_like(white)
        for block in self.bins.blocks:
            _, root = self._factors(block.stop - block.start)
            errors[:, block] = (root @ white[:, block, None])[..., 0]
        return np.asarray(errors * self.scale[:, None])

    def row_weights(self, rows: int) -> Floats:
        """(n, 21) how much each row counts; 1 outside the fit part."""
        weights = np.ones((rows, len(CHANNELS)))
        weights[self.bins.order] = np.repeat(self._counts.T**2, self.bins.sizes, axis=0)
        return weights

    @property
    def ones(self) -> Floats:
        """(21, bins, 1) a whitened constant of each channel, as large as its residual."""
        return self(np.broadcast_to(self.scale[:, None, None], (len(CHANNELS), len(self.bins), 1)))

    def _factors(self, count: int) -> tuple[Floats, Floats]:
        """What whitens a block's bins, and what colours them again, each (21, count, count)."""
        if count not in self._known:
            shares = zip(self._shape.shared, self._shape.fading, strict=True)
            roots = np.stack([np.linalg.cholesky(covariance(count, *both, self._step)) for both in shares])
            self._known[count] = np.linalg.inv(roots), roots
        return self._known[count]

    def __call__(self, means: Floats) -> Floats:
        """(21, bins, k) of means (1 or 21, bins, k), counts."""
        white = np.empty((len(CHANNELS), *means.shape[1:]))
        for block in self.bins.blocks:
            white[:, block] = self._factors(block.stop - block.start)[0] @ means[:, block]
        white *= (self._counts / self.scale[:, None])[:, :, None]
        return white

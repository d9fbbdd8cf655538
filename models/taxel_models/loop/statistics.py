"""Sufficient statistics: least squares on the blocks' sums of a candidate's regressors and the residual.

The weights, the cross-validation and the test against chance all follow from these sums, so the rows are
read once.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_models.loop.basis import Basis, Floats, broadcast
from taxel_models.loop.blocks import Blocks

RIDGE: Final = 1e-3
"""The ridge, relative to each regressor's energy: nearly collinear regressors get stable weights."""


@dataclass(frozen=True)
class Fitting:
    """How weights are fitted.

    Attributes:
        pooled: whether all channels share their weights, as they share the cause.
        fixed: whether the weights are 1 and nothing is fitted.
        allowed: (21, k), which weights may differ from 0; None for all.
        ridge: (k,) each regressor's ridge over its energy, for many nearly collinear regressors. Their
            weights are not shrunk again. None for few regressors.
    """

    pooled: bool = False
    fixed: bool = False
    allowed: NDArray[np.bool_] | None = None
    ridge: Floats | None = None


@dataclass(frozen=True)
class SufficientStatistics:
    """The sums over each fit block, counts².

    Attributes:
        regressors: (blocks, 1 or 21, k, k).
        cross: (blocks, 21, k), with the residual.
        energy: (blocks, 21), of the residual.
        fold: (blocks,) of the cross-validation.
        fitting: how weights are found.
    """

    regressors: Floats
    cross: Floats
    energy: Floats
    fold: NDArray[np.int64]
    fitting: Fitting

    @classmethod
    def of(
        cls, basis: Basis, residual: Floats, row_weights: Floats, blocks: Blocks, fitting: Fitting
    ) -> Self:
        """Of a basis with a residual (n, 21), each row counted by its row_weights (n,)."""
        of_row = blocks.of_row if basis.rows is None else blocks.of_row[basis.rows]
        known = residual if basis.rows is None else residual[basis.rows]
        counted = row_weights if basis.rows is None else row_weights[basis.rows]
        wanted = np.flatnonzero(blocks.fold >= 0)
        order = np.argsort(of_row, kind="stable")
        starts = np.searchsorted(of_row[order], np.arange(len(blocks) + 1))
        grams, crosses, energies = [], [], []
        for block in wanted:
            rows = order[starts[block] : starts[block + 1]]
            values, targets = basis.at(rows), known[rows].T
            weighed = values * counted[rows][None, :, None]
            grams.append(values.transpose(0, 2, 1) @ weighed)
            crosses.append((targets[:, None, :] @ weighed)[:, 0])
            energies.append((targets**2) @ counted[rows])
        return cls(np.array(grams), np.array(crosses), np.array(energies), blocks.fold[wanted], fitting)

    @property
    def folds(self) -> int:
        """Folds of the cross-validation."""
        return int(self.fold.max()) + 1

    def weights(self, scale: Floats, left_out: int | None = None) -> Floats:
        """(21, k) weights fitted to all blocks, or to all but one fold's.

        Each channel's are shrunk by what chance alone would give them (positive-part James-Stein):
        times 1 - 1/F, and nil where F is below 1.

        Args:
            scale: (21,) what an error of each channel counts, 1/counts².
        """
        kept = np.ones(len(self.fold), bool) if left_out is None else self.fold != left_out
        weights = self._solved(self.regressors[kept].sum(axis=0), self.cross[kept].sum(axis=0), scale)
        if self.fitting.fixed or self.fitting.ridge is not None:
            return weights
        strength = self.strength(scale, kept)
        return np.asarray(weights * np.maximum(0.0, 1.0 - 1.0 / np.maximum(strength, 1e-9))[:, None])

    def gains(self, scale: Floats, tested: "SufficientStatistics | None" = None) -> Floats:
        """(folds, 21) error that weights fitted without a fold take away in it, scaled.

        Args:
            scale: (21,) what an error of each channel counts, 1/counts².
            tested: the same candidate's statistics with rows counted otherwise, to test on.
        """
        tested = tested or self
        gains = np.empty((self.folds, len(CHANNELS)))
        for number in range(self.folds):
            test = self.fold == number
            weights = self.weights(scale, left_out=number)
            cross = tested.cross[test].sum(axis=0)
            gram = tested.regressors[test].sum(axis=0)
            gram = np.broadcast_to(gram, (len(CHANNELS), *gram.shape[1:]))
            explained = 2 * (weights * cross).sum(axis=1)
            gains[number] = (explained - np.einsum("ck,ckl,cl->c", weights, gram, weights)) * scale
        return gains

    def strength(self, scale: Floats, kept: NDArray[np.bool_] | None = None) -> Floats:
        """(21,) F of each channel's weights: how far the blocks agree on them; see `strengths`."""
        cross = self.cross if kept is None else self.cross[kept]
        return np.asarray(self.strengths(scale, np.ones((1, len(cross))), cross)[0])

    def strengths(self, scale: Floats, signs: Floats, cross: Floats | None = None) -> Floats:
        """(draws, 21) Hotelling's F of the blocks' score vectors, blocks as the independent units.

        The score of a block is its regressors' product with the residual; under no effect its mean is
        0, whatever rows inside a block share (a cluster-robust score test).

        Args:
            signs: (draws, blocks) of +1 and -1, the sign of each block's residual. With random signs, a
                candidate explains only chance.
            cross: of the blocks to use; all if None.
        """
        cross = self.cross if cross is None else cross
        if self.fitting.pooled or self.fitting.fixed:
            weighed = cross * scale[:, None]
            if self.fitting.allowed is not None:
                weighed = weighed * self.fitting.allowed
            if self.fitting.pooled:
                weighed = np.broadcast_to(weighed.sum(axis=1, keepdims=True), cross.shape)
            cross = weighed
        blocks, _, size = cross.shape
        covariance = np.einsum("bck,bcl->ckl", cross, cross, optimize=True)
        inverse = np.linalg.inv(_steadied(covariance, 1e-6))
        total = np.einsum("db,bck->dck", signs, cross, optimize=True)
        squared = np.einsum("dck,ckl,dcl->dc", total, inverse, total, optimize=True)
        room = np.maximum(blocks - squared, 1e-3 * blocks)
        return np.asarray(np.maximum(blocks - size, 1) / size * squared / room)

    def _solved(self, gram: Floats, cross: Floats, scale: Floats) -> Floats:
        """(21, k) weights of statistics (1 or 21, k, k) and (21, k)."""
        size = gram.shape[-1]
        fitting = self.fitting
        allowed = np.ones((len(CHANNELS), size), bool) if fitting.allowed is None else fitting.allowed
        if fitting.fixed:
            return allowed.astype(np.float64)
        if fitting.pooled:
            counted = scale * allowed.any(axis=1)
            whole = (np.broadcast_to(gram, (len(CHANNELS), size, size)) * counted[:, None, None]).sum(
                axis=0
            )
            solved = np.linalg.solve(_steadied(whole), (cross * counted[:, None]).sum(axis=0))
            return np.asarray(broadcast(solved, size) * allowed)
        if fitting.allowed is not None:
            gram, cross = gram * (allowed[:, :, None] & allowed[:, None, :]), cross * allowed
        ridge = RIDGE if fitting.ridge is None else fitting.ridge
        return np.asarray((np.linalg.inv(_steadied(gram, ridge)) @ cross[..., None])[..., 0])


def _steadied(gram: Floats, ridge: float | Floats = RIDGE) -> Floats:
    diagonal = np.einsum("...kk->...k", gram)
    floor = diagonal.max(axis=-1, keepdims=True) * 1e-12 + 1e-12
    return np.asarray(gram + np.eye(gram.shape[-1]) * (ridge * diagonal + floor)[..., None, :])

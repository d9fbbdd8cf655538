"""Whitened regressors beside a base, and their sums of products, fold by fold: what all inference needs.

Sums over any choice of folds follow from those of each fold, so that nothing is computed again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from taxel_models.loop.basis import Floats


@dataclass(frozen=True)
class Design:
    """Whitened regressors.

    Attributes:
        values: (21, bins, k).
        fold: (bins,), ascending.
    """

    values: Floats
    fold: NDArray[np.int64]

    def products(self, other: "Design") -> Floats:
        """(folds, 21, k, other k) sums of products over the bins of each fold."""
        edges = np.searchsorted(self.fold, np.arange(int(self.fold.max()) + 2))
        mine = self.values.transpose(0, 2, 1)
        parts = pairwise(edges)
        return np.stack([mine[:, :, start:stop] @ other.values[:, start:stop] for start, stop in parts])

    def beside(self, other: "Design") -> "Design":
        """Both together."""
        return Design(np.concatenate([self.values, other.values], axis=2), self.fold)


@dataclass(frozen=True)
class Base:
    """The residual, and the regressors that are in the model already.

    Attributes:
        target: (21, bins, 1) the whitened residual.
        design: (21, bins, k).
        precision: (21, k) of the weights over the noise's; infinite where a channel has none.
        quantum: (21,) squared, what rounding alone leaves in a bin.
        known_noise: (21,) mean square of the noise, but for one factor that all channels have in common;
            None where each channel's own is inferred from what is left of it.
        not_served: so many of the first regressors stand for what no effect can take off.
    """

    target: Design
    design: Design
    precision: Floats
    quantum: Floats
    known_noise: Floats | None = None
    not_served: int = 0

    @property
    def bins(self) -> int:
        """Their number."""
        return int(self.target.values.shape[1])

    @cached_property
    def gram(self) -> Floats:
        """(folds, 21, k, k)."""
        return self.design.products(self.design)

    @cached_property
    def cross(self) -> Floats:
        """(folds, 21, k)."""
        return self.design.products(self.target)[..., 0]

    @cached_property
    def energy(self) -> Floats:
        """(folds, 21)."""
        return self.target.products(self.target)[..., 0, 0]

    @cached_property
    def noise(self) -> Floats:
        """(21,) mean square of the residual that the base leaves, rounding included."""
        cross, inverse = self.cross.sum(axis=0), inverse_of(self.gram.sum(axis=0), self.precision)
        left = self.energy.sum(axis=0) - bilinear(cross, inverse, cross)
        return np.asarray(np.maximum(left / self.bins, 0.0) + self.quantum)

    @property
    def counted_noise(self) -> Floats:
        """(21,) the noise that weights which channels have in common are found with."""
        return self.noise if self.known_noise is None else self.known_noise

    def with_constant(self, ones: Design) -> Self:
        """With a constant of each channel as the last regressor."""
        precision = np.column_stack([self.precision, np.ones(len(self.precision))])
        return replace(self, design=self.design.beside(ones), precision=precision)

    def without_last(self) -> Self:
        """The last regressor has no weight; all products stay as they are."""
        precision = self.precision.copy()
        precision[:, -1] = np.inf
        other = replace(self, precision=precision)
        other.__dict__.update(gram=self.gram, cross=self.cross, energy=self.energy)
        return other

    def given(self, sums: "Sums") -> tuple[Floats, Floats, Floats]:
        """Products of new regressors with themselves and the residual, and its energy, given the base."""
        inverse = inverse_of(sums.base_gram, self.precision)
        half = inverse @ sums.between
        return (
            sums.gram - np.swapaxes(sums.between, -1, -2) @ half,
            sums.cross - np.einsum("...bk,...b->...k", half, sums.base_cross),
            sums.energy - bilinear(sums.base_cross, inverse, sums.base_cross),
        )


@dataclass(frozen=True)
class Sums:
    """Products over some folds of a base and of new regressors: what all inference needs.

    For several choices of folds, the choices are the first axis of each.
    """

    base_gram: Floats
    base_cross: Floats
    energy: Floats
    between: Floats
    gram: Floats
    cross: Floats


@dataclass(frozen=True)
class Products:
    """The products of a base and of new regressors, fold by fold."""

    base: Base
    design: Design
    between: Floats
    gram: Floats
    cross: Floats

    @classmethod
    def of(cls, base: Base, design: Design) -> Self:
        """Of a base and new regressors."""
        between, gram = base.design.products(design), design.products(design)
        return cls(base, design, between, gram, design.products(base.target)[..., 0])

    @property
    def folds(self) -> int:
        """Their number."""
        return len(self.gram)

    def of_some(self, regressors: Sequence[int]) -> Self:
        """Of some of the new regressors."""
        kept = list(regressors)
        return replace(
            self,
            design=replace(self.design, values=self.design.values[..., kept]),
            between=self.between[..., kept],
            gram=self.gram[..., kept, :][..., kept],
            cross=self.cross[..., kept],
        )

    def sums(self, kept: NDArray[np.bool_] | None = None) -> Sums:
        """Over all folds, or over those that are kept (folds,), or (choices, folds)."""
        folds = np.ones(self.folds) if kept is None else kept.astype(np.float64)
        base = self.base
        parts = (base.gram, base.cross, base.energy, self.between, self.gram, self.cross)
        flat = (folds @ part.reshape(len(part), -1) for part in parts)
        shapes = ((*folds.shape[:-1], *part.shape[1:]) for part in parts)
        return Sums(*(sums.reshape(shape) for sums, shape in zip(flat, shapes, strict=True)))


def inverse_of(gram: Floats, precision: Floats) -> Floats:
    """Inverse of gram (…, 21, k, k) plus diagonal precision (21, k); 0 where the precision is infinite."""
    kept = np.isfinite(precision)
    both = kept[:, :, None] & kept[:, None, :]
    diagonal = np.arange(gram.shape[-1])
    matrix = np.where(both, gram, 0.0)
    matrix[..., diagonal, diagonal] += np.where(kept, precision, 1.0)
    return np.asarray(np.where(both, np.linalg.inv(matrix), 0.0))


def bilinear(left: Floats, gram: Floats, right: Floats) -> Floats:
    """left' gram right, of the last axes."""
    return np.asarray(np.einsum("...k,...kl,...l->...", left, gram, right))

"""Whitened regressors beside a base, and their sums of products, fold by fold: what all inference needs.

Sums over any choice of folds follow from those of each fold, so that nothing is computed again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, Self

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


class BaseSums(NamedTuple):
    """A base's regression on some folds. For several choices of folds, the choices are the first axis.

    Attributes:
        cross: (…, 21, k) products with the residual.
        inverse: (…, 21, k, k) of the products with themselves, and of the precision of weights.
        weights: (…, 21, k) that fit the residual best.
        energy: (…, 21) what they leave of the residual's sum of squares.
    """

    cross: Floats
    inverse: Floats
    weights: Floats
    energy: Floats


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
        return np.asarray(np.maximum(self.sums().energy / self.bins, 0.0) + self.quantum)

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

    @cached_property
    def _known(self) -> dict[bytes | None, BaseSums]:
        return {}

    def sums(self, kept: NDArray[np.bool_] | None = None) -> BaseSums:
        """Over all folds, or over those that are kept (folds,), or (choices, folds); each computed once."""
        choice = None if kept is None else kept.tobytes()
        if choice not in self._known:
            gram, cross, energy = (over(kept, part) for part in (self.gram, self.cross, self.energy))
            inverse = inverse_of(gram, self.precision)
            weights = (inverse @ cross[..., None])[..., 0]
            self._known[choice] = BaseSums(cross, inverse, weights, energy - (cross * weights).sum(axis=-1))
        return self._known[choice]


class Sums(NamedTuple):
    """Products over some folds of a base and of new regressors: what all inference needs.

    For several choices of folds, the choices are the first axis of each.
    """

    base: BaseSums
    between: Floats
    gram: Floats
    cross: Floats

    def given_base(self) -> tuple[Floats, Floats, Floats]:
        """Products of new regressors with themselves and the residual, and its energy, given the base."""
        across = np.swapaxes(self.between, -1, -2)
        return (
            self.gram - across @ (self.base.inverse @ self.between),
            self.cross - (across @ self.base.weights[..., None])[..., 0],
            self.base.energy,
        )


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
        parts = (over(kept, part) for part in (self.between, self.gram, self.cross))
        return Sums(self.base.sums(kept), *parts)


def over(kept: NDArray[np.bool_] | None, parts: Floats) -> Floats:
    """Sums of parts (folds, …) over all folds, or those that are kept (folds,) or (choices, folds)."""
    if kept is None:
        return np.asarray(parts.sum(axis=0))
    sums = kept.astype(np.float64) @ parts.reshape(len(parts), -1)
    return np.asarray(sums.reshape(*kept.shape[:-1], *parts.shape[1:]))


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

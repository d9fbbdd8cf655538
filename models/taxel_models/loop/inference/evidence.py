"""Evidence: how much likelier the residual is with an effect than without it.

y_c = X_S w_Sc + X_e w_ec + noise, for each channel c, whitened. Weights are normal, with a variance that
is a multiple of the noise's. The noise's size has a flat prior on its logarithm and is integrated out, so
the marginal likelihood has a closed form (a Student t; Bishop 2006, section 3.5).
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taxel_models.loop.basis import Floats
from taxel_models.loop.effects.effect import Fitting
from taxel_models.loop.inference.constants import Constants
from taxel_models.loop.inference.products import Base, Design, Products, bilinear, inverse_of


@dataclass(frozen=True)
class Weighed:
    """The evidence for one form.

    Attributes:
        log_evidence: natural logarithm of the odds with the form to those without it.
        strength: the likeliest prior size of its weights, over the channel's residual.
        included: (21,) probability that a channel has it.
        by_channel: (21,) log odds of each channel at that strength.
    """

    log_evidence: float
    strength: float
    included: Floats
    by_channel: Floats

    @property
    def changes(self) -> NDArray[np.bool_]:
        """(21,) channels that have it more likely than not."""
        return np.asarray(self.included > 0.5)


def weigh(
    products: Products, fitting: Fitting, constants: Constants, usual: Floats | float = 0.0
) -> Weighed:
    """The evidence for a form beside a base. Its regressors have a mean square of 1 over the scale.

    Args:
        usual: (21,) log odds that each channel's residual gives the effect anyway.
    """
    base = products.base
    gram, cross, energy = products.sums().given_base()
    energy = np.maximum(energy, 0.0) + base.bins * base.quantum
    half, channels = 0.5 * base.bins, len(energy)
    allowed = np.ones(channels, bool) if fitting.allowed is None else fitting.allowed
    # The price of a parameter by the Bayesian information criterion (Schwarz 1978).
    price = 0.5 * fitting.beforehand * np.log(base.bins)
    if fitting.fixed:
        left = energy - 2 * cross.sum(axis=1) + gram.sum(axis=(1, 2))
        by_channel = -half * np.log(np.maximum(left, 1e-9 * energy) / energy) * allowed
        total = float((by_channel - usual)[allowed].sum() - price - np.log(fitting.choices))
        return Weighed(total, 1.0, allowed.astype(float), by_channel)
    if fitting.pooled:
        shared = _pooled(base, gram, cross, energy, allowed, constants, usual, positive=fitting.positive)
        return replace(shared, log_evidence=shared.log_evidence - price)
    if fitting.positive:
        cross = np.maximum(cross, 0.0)
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    turned = np.einsum("ckl,ck->cl", vectors, cross) ** 2
    variance = np.square(constants.strengths)[:, None, None]
    left = np.maximum(energy - (turned / (values + 1 / variance)).sum(axis=2), 1e-9 * energy)
    volume = 0.5 * np.log1p(variance * values).sum(axis=2)
    factors = -volume - half * np.log(left / energy) - np.log(fitting.choices)
    own, share = (factors - usual)[:, None], np.array(constants.included)[:, None]
    # A channel has the effect with a prior probability: log((1 - share) + share exp(own)).
    with np.errstate(divide="ignore"):
        mixed = np.logaddexp(np.log1p(-share), np.log(share) + own)
    table = mixed[..., allowed].sum(axis=2)
    row, column = divmod(int(table.argmax()), table.shape[1])
    included = share[column] * np.exp(own[row, 0] - mixed[row, column]) * allowed
    return Weighed(mean_odds(table) - price, constants.strengths[row], included, factors[row] * allowed)


class Bases(NamedTuple):
    """What forms are weighed beside, and the evidence of the constant between the two."""

    plain: Base
    beside: Base
    constant: float

    @classmethod
    def of(cls, base: Base, ones: Design, constants: Constants) -> Self:
        """A base, and the same beside a constant of each channel."""
        beside = base.with_constant(ones)
        plain = beside.without_last()
        return cls(plain, beside, weigh(Products.of(plain, ones), Fitting(), constants).log_evidence)

    @property
    def of_constant(self) -> Self:
        """What a constant itself is weighed beside: there is no other one."""
        return self._replace(beside=self.plain, constant=0.0)


def mean_odds(logs: ArrayLike) -> float:
    """The logarithm of the mean of odds, of their logarithms."""
    return float(np.logaddexp.reduce(logs, axis=None) - np.log(np.size(logs)))


def _pooled(
    base: Base,
    gram: Floats,
    cross: Floats,
    energy: Floats,
    allowed: NDArray[np.bool_],
    constants: Constants,
    usual: Floats | float,
    *,
    positive: bool,
) -> Weighed:
    """Weights that all channels share: the posterior's height and width (Laplace)."""
    half = 0.5 * base.bins
    together = None if base.known_noise is None else 1.0 / base.known_noise[allowed]
    anyway = float(np.broadcast_to(usual, allowed.shape)[allowed].sum())
    gram, cross, energy = gram[allowed], cross[allowed], energy[allowed]
    strengths, size = np.array(constants.strengths), gram.shape[-1]
    precision = np.eye(size) / strengths[:, None, None] ** 2
    left = np.broadcast_to(energy, (len(strengths), len(energy)))
    for _ in range(12):
        # What is left says how large the noise is: of each channel, or of all together.
        noise = left if together is None else (left @ together)[:, None] / (together * len(together))
        counted = 2 * half / noise
        curvature = np.tensordot(counted, gram, axes=1) + precision
        weights = np.linalg.solve(curvature, (counted @ cross)[..., None])[..., 0]
        weights = np.maximum(weights, 0.0) if positive else weights
        explained = ((gram @ weights.T) * weights.T).sum(axis=1).T
        left = np.maximum(energy - 2 * weights @ cross.T + explained, 1e-9 * energy)
    by_channel = -half * np.log(left / energy)
    if together is not None:
        by_channel[:] = -half * np.log((left @ together) / (together @ energy))[:, None]
    height = by_channel.sum(axis=1) - 0.5 * (weights**2).sum(axis=1) / strengths**2
    volume = 0.5 * np.linalg.slogdet(curvature)[1] + size * np.log(strengths)
    found = height - volume
    best = int(found.argmax())
    every = np.zeros(len(allowed))
    every[allowed] = by_channel[best]
    strength = constants.strengths[best]
    return Weighed(mean_odds(found) - anyway, strength, allowed.astype(np.float64), every)


def posterior_weights(
    products: Products, fitting: Fitting, weighed: Weighed, kept: NDArray[np.bool_] | None = None
) -> tuple[Floats, Floats]:
    """The posterior mean of the base's weights (…, 21, base k) and of the form's (…, 21, k).

    Args:
        kept: (folds,) or (choices, folds) that they are fitted to; all if None.
    """
    base, sums, changes = products.base, products.sums(kept), weighed.changes
    gram, cross, _ = sums.given_base()
    if fitting.fixed:
        weights = np.broadcast_to(changes[:, None], cross.shape).astype(np.float64)
    elif fitting.pooled:
        counted = changes / base.counted_noise
        pooled = np.tensordot(gram, counted, axes=(-3, 0)) + np.eye(gram.shape[-1]) / weighed.strength**2
        common = np.linalg.solve(pooled, np.tensordot(cross, counted, axes=(-2, 0))[..., None])
        weights = np.swapaxes(common, -1, -2) * changes[:, None]
    else:
        precision = np.where(changes, weighed.strength**-2, np.inf)
        inverse = inverse_of(gram, np.broadcast_to(precision[:, None], cross.shape[-2:]))
        weights = (inverse @ cross[..., None])[..., 0]
    if fitting.positive and not fitting.fixed:
        weights = np.maximum(weights, 0.0)
    remaining = sums.base.cross - (sums.between @ weights[..., None])[..., 0]
    return (sums.base.inverse @ remaining[..., None])[..., 0], weights


@dataclass(frozen=True)
class HeldOut:
    """What a form explains of folds that nothing was fitted to, beside a base.

    Attributes:
        gain: (folds, 21) fall of the squared error over the noise.
        before: (folds, 21) the base's squared error over the noise.
        noise: (21,) mean square that the base leaves in a bin, over the scale.
        squared_change: (folds, 21) square of the change that it foretells, over the noise.
    """

    gain: Floats
    before: Floats
    noise: Floats
    squared_change: Floats

    @property
    def shares(self) -> Floats:
        """(21,) the share of each channel's held-out error that goes."""
        return np.asarray(self.gain.sum(axis=0) / np.maximum(self.before.sum(axis=0), 1e-12))


def weights_by_fold(
    products: Products, fitting: Fitting, weighed: Weighed, *, seen: bool = False
) -> tuple[Floats, Floats, Floats]:
    """The base's weights alone and beside a form (folds, 21, base k), and the form's (folds, 21, k).

    Args:
        seen: fit to all folds, in place of all but one.
    """
    kept = ~np.eye(products.folds, dtype=bool) | seen
    return products.base.sums(kept).weights, *posterior_weights(products, fitting, weighed, kept)


def held_out(products: Products, fitting: Fitting, weighed: Weighed, *, seen: bool = False) -> HeldOut:
    """Fit to all folds but one, test on that one; fold after fold.

    Args:
        seen: fit to all folds instead.
    """
    base = products.base
    plain, beside, weights = weights_by_fold(products, fitting, weighed, seen=seen)
    moved, nothing = beside - plain, np.zeros_like(base.energy)
    alone = _squares(base.energy, plain, base.cross, base.gram)
    after = _squares(base.energy, beside, base.cross, base.gram)
    after += _squares(nothing, weights, products.cross, products.gram)
    after += 2 * bilinear(beside, products.between, weights)
    square = bilinear(moved, base.gram, moved) + 2 * bilinear(moved, products.between, weights)
    square += bilinear(weights, products.gram, weights)
    noise = base.counted_noise
    return HeldOut((alone - after) / noise, alone / noise, noise, square / noise)


def _squares(energy: Floats, weights: Floats, cross: Floats, gram: Floats) -> Floats:
    return np.asarray(energy - 2 * (weights * cross).sum(axis=-1) + bilinear(weights, gram, weights))

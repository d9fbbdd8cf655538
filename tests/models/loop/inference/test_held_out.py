"""What is explained of held-out folds, against plain refits."""

from collections.abc import Callable

import numpy as np
import pytest

from taxel_models.loop.effects.effect import Fitting
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.evidence import Weighed, held_out, posterior_weights, weigh
from taxel_models.loop.inference.products import Base, Design, Products
from taxel_models.loop.inference.score import t_over_folds

Draw = Callable[..., Products]


def made(draw: Draw, seed: int, base_size: int) -> tuple[Products, np.ndarray]:
    """Products, and the new regressors (21, bins, 2) they are of."""
    drawn = draw(seed, base_size=base_size, quantum=0.2)
    values = np.random.default_rng(seed).normal(size=(21, drawn.base.bins, 2))
    return Products.of(drawn.base, Design(values, drawn.base.target.fold)), values


@pytest.mark.parametrize("base_size", [0, 1, 3])
@pytest.mark.parametrize("pooled", [False, True])
def test_gains_are_those_of_plain_refits(draw: Draw, base_size: int, pooled: bool) -> None:
    products, values = made(draw, 2, base_size)
    base, fitting = products.base, Fitting(pooled=pooled)
    weighed = Weighed(1.0, 0.5, np.ones(21), np.ones(21))
    found = held_out(products, fitting, weighed)
    target, own = base.target.values[:, :, 0], base.design.values
    noise = np.empty(21)
    for channel in range(21):
        weights = ridge(own[channel], target[channel], np.full(base_size, 4.0))
        # The energy that a normal prior of the weights leaves.
        noise[channel] = target[channel] @ (target[channel] - own[channel] @ weights) / base.bins + 0.2
    np.testing.assert_allclose(found.noise, noise)
    for fold in range(4):
        test = base.target.fold == fold
        gain, before, moved = refit(target, own, values, test, noise, pooled=pooled)
        np.testing.assert_allclose(found.squared_change[fold], moved / noise, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(found.before[fold], before / noise, rtol=1e-8)
        np.testing.assert_allclose(found.gain[fold], gain / noise, rtol=1e-6, atol=1e-8)


def refit(
    target: np.ndarray,
    own: np.ndarray,
    values: np.ndarray,
    test: np.ndarray,
    noise: np.ndarray,
    *,
    pooled: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(21,) fall of the squared error on one fold, the base's, and the squared change; by all others."""
    prior, size = np.full(own.shape[2], 4.0), values.shape[2]
    both = np.concatenate([own, values], axis=2)
    common = np.zeros(size)
    if pooled:
        common = pooled_weights(target[:, ~test], own[:, ~test], values[:, ~test], noise)
    gain, before, moved = np.empty((3, 21))
    for channel in range(21):
        plain = ridge(own[channel, ~test], target[channel, ~test], prior)
        if pooled:
            left = target[channel] - values[channel] @ common
            beside = ridge(own[channel, ~test], left[~test], prior)
            weights = np.concatenate([beside, common])
        else:
            weights = ridge(
                both[channel, ~test], target[channel, ~test], np.append(prior, np.full(size, 4.0))
            )
        before[channel] = ((target[channel] - own[channel] @ plain)[test] ** 2).sum()
        after = ((target[channel] - both[channel] @ weights)[test] ** 2).sum()
        gain[channel] = before[channel] - after
        moved[channel] = ((both[channel] @ weights - own[channel] @ plain)[test] ** 2).sum()
    return gain, before, moved


def ridge(values: np.ndarray, target: np.ndarray, precision: np.ndarray) -> np.ndarray:
    return np.linalg.solve(values.T @ values + np.diag(precision), values.T @ target)


def pooled_weights(
    target: np.ndarray, own: np.ndarray, values: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """(k,) common weights, by the covariance of each channel's residual under its base."""
    gram, cross = np.eye(values.shape[2]) / 0.5**2, np.zeros(values.shape[2])
    for channel in range(21):
        covariance = np.eye(target.shape[1]) + own[channel] @ own[channel].T / 4.0
        weighted = np.linalg.solve(covariance, values[channel]).T / noise[channel]
        gram, cross = gram + weighted @ values[channel], cross + weighted @ target[channel]
    return np.linalg.solve(gram, cross)


def test_chance_gains_nothing_on_average() -> None:
    ts = []
    for seed in range(40):
        random = np.random.default_rng(seed)
        values, target = random.normal(size=(2, 21, 160, 1))
        fold = np.sort(np.arange(160) % 8)
        none = Design(np.empty((21, 160, 0)), fold)
        base = Base(Design(target, fold), none, np.empty((21, 0)), np.zeros(21))
        products = Products.of(base, Design(values, fold))
        found = held_out(products, Fitting(), weigh(products, Fitting(), DECLARED))
        ts.append(t_over_folds(found.gain, Weighed(0.0, 0.5, np.ones(21), np.zeros(21))))
    assert np.mean(np.array(ts) >= DECLARED.least_t(8)) < 0.05


def test_channels_that_change_count_and_others_do_not() -> None:
    random = np.random.default_rng(0)
    gain = random.normal(size=(8, 21))
    gain[:, 4] += 20.0
    only = np.zeros(21)
    only[4] = 1.0
    t = t_over_folds(gain, Weighed(1.0, 0.5, only, only))
    roots = np.sqrt(gain[:, 4])
    assert t == pytest.approx(roots.mean() / (roots.std(ddof=1) * np.sqrt(1 / 8 + 1 / 7)))
    # Beside the noise of all others, what the other folds show tells which channel counts.
    noisy = gain + np.where(np.arange(21) == 4, 0.0, 30.0 * random.normal(size=(8, 21)))
    plain = noisy.sum(axis=1)
    simple = plain.mean() / (plain.std(ddof=1) * np.sqrt(1 / 8 + 1 / 7))
    assert t_over_folds(noisy, Weighed(1.0, 0.5, np.ones(21), np.ones(21))) >= simple


def test_chance_shows_as_much_in_sample_as_it_costs_on_held_out_bins(draw: Draw) -> None:
    """The mean of both tells what a form explains: here nothing."""
    inside, outside = [], []
    weighed = Weighed(1.0, 1e3, np.ones(21), np.ones(21))
    for seed in range(20):
        products = draw(seed, bins=120, base_size=0, size=2, folds=8)
        random = np.random.default_rng(seed)
        base = products.base
        noise = Design(random.normal(size=base.target.values.shape), base.target.fold)
        values = Design(random.normal(size=(21, 120, 2)), base.target.fold)
        chance = Products.of(Base(noise, base.design, base.precision, base.quantum), values)
        for gains, seen in ((inside, True), (outside, False)):
            tested = held_out(chance, Fitting(), weighed, seen=seen)
            gains.append((tested.gain * tested.noise).sum(axis=0).mean())
    assert np.mean(inside) == pytest.approx(2.0, rel=0.1)
    assert np.mean(outside) == pytest.approx(-2.0, rel=0.25)


@pytest.mark.parametrize("pooled", [False, True])
def test_weights_of_the_wrong_sign_are_no_evidence(draw: Draw, pooled: bool) -> None:
    products, every = draw(4, size=1), Weighed(1.0, 0.5, np.ones(21), np.ones(21))
    free, bound = Fitting(pooled=pooled), Fitting(pooled=pooled, positive=True)
    _, weights = posterior_weights(products, Fitting(), every)
    right = np.sign(weights)

    def turned(signs: np.ndarray) -> Products:
        between, cross = products.between * signs[:, :, None], products.cross * signs
        return Products(products.base, products.design, between, products.gram, cross)

    some, only = (weigh(turned(right), fitting, DECLARED) for fitting in (free, bound))
    np.testing.assert_allclose(only.by_channel, some.by_channel)
    _, kept = posterior_weights(turned(right), bound, every)
    assert (kept > 0).all()
    wrong = weigh(turned(-right), bound, DECLARED)
    assert (wrong.by_channel <= 1e-9).all()
    assert wrong.log_evidence < 0 < some.log_evidence
    _, kept = posterior_weights(turned(-right), bound, every)
    np.testing.assert_array_equal(kept, 0.0)

"""The evidence against independent computations of the same marginal likelihood."""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, special, stats

from taxel_models.loop.effects.effect import Fitting
from taxel_models.loop.inference.constants import DECLARED, Constants
from taxel_models.loop.inference.evidence import posterior_weights, weigh
from taxel_models.loop.inference.products import Base, Design, Products

Draw = Callable[..., Products]

ALMOST_FLAT: Final = 1e-7
"""Degrees of freedom of a Student t whose prior of the noise's size is nearly flat on its logarithm."""


def regressors(products: Products, seed: int, size: int = 2) -> np.ndarray:
    """(21, bins, size) the new regressors that `draw` made, drawn again."""
    random = np.random.default_rng(seed)
    base = products.base.design.values
    random.normal(size=base.shape)
    values = random.normal(size=(*base.shape[:2], size))
    return values + 0.5 * base[:, :, :1] if base.shape[2] else values


def marginal(target: np.ndarray, parts: list[tuple[np.ndarray, float]]) -> float:
    """Log marginal likelihood of a channel's residual whose weights are normal beside the noise's size."""
    shape = np.eye(len(target))
    for values, variance in parts:
        shape = shape + variance * values @ values.T
    return float(stats.multivariate_t(shape=shape, df=ALMOST_FLAT).logpdf(target))


def by_brute_force(products: Products, values: np.ndarray, constants: Constants) -> float:
    """Log odds, by the marginal likelihood of each channel, each strength, and each share of channels."""
    base = products.base
    odds = []
    for strength in constants.strengths:
        by_channel = np.empty(21)
        for channel in range(21):
            target = base.target.values[channel, :, 0]
            known = [(base.design.values[channel], 1 / 4.0)]
            more = [*known, (values[channel], strength**2)]
            by_channel[channel] = marginal(target, more) - marginal(target, known)
        odds += [np.log(1 - share + share * np.exp(by_channel)).sum() for share in constants.included]
    return float(special.logsumexp(odds) - np.log(len(odds)))


@pytest.mark.parametrize("base_size", [0, 1, 3])
def test_evidence_is_the_odds_of_two_student_t(draw: Draw, base_size: int) -> None:
    products = draw(3, base_size=base_size)
    found = weigh(products, Fitting(), DECLARED)
    expected = by_brute_force(products, regressors(products, 3), DECLARED)
    assert found.log_evidence == pytest.approx(expected, abs=1e-3)


def test_a_channel_has_the_effect_with_its_posterior_probability(draw: Draw) -> None:
    products = draw(4, bins=60)
    found = weigh(products, Fitting(), DECLARED)
    # Of equal prior shares, the likeliest one is taken with the likeliest strength.
    odds = np.exp(found.by_channel)
    shares = [share * odds / (1 - share + share * odds) for share in DECLARED.included]
    assert min(np.abs(found.included - share).max() for share in shares) < 1e-9
    np.testing.assert_array_equal(found.changes, found.included > 0.5)


def test_an_effect_of_one_channel_is_told_from_chance_in_the_others() -> None:
    random = np.random.default_rng(8)
    values, target = random.normal(size=(2, 21, 300, 1))
    target[6] += 0.8 * values[6]
    fold = np.sort(np.arange(300) % 8)
    base = Base(Design(target, fold), Design(np.empty((21, 300, 0)), fold), np.empty((21, 0)), np.zeros(21))
    found = weigh(Products.of(base, Design(values, fold)), Fitting(), DECLARED)
    assert found.log_evidence > 30
    assert found.included[6] > 0.999
    assert found.changes.sum() <= 3


def test_chance_speaks_against_an_effect() -> None:
    for seed in range(10):
        random = np.random.default_rng(seed)
        values, target = random.normal(size=(2, 21, 200, 1))
        fold = np.sort(np.arange(200) % 8)
        none = Design(np.empty((21, 200, 0)), fold)
        base = Base(Design(target, fold), none, np.empty((21, 0)), np.zeros(21))
        assert weigh(Products.of(base, Design(values, fold)), Fitting(), DECLARED).log_evidence < 0


def test_pooled_evidence_is_the_integral_over_the_common_weight(draw: Draw) -> None:
    products = draw(5, bins=300, base_size=0, size=1)
    energy, cross, gram = (
        part[..., 0].sum(axis=0) if part.ndim == 3 else part.sum(axis=0)
        for part in (products.base.energy, products.cross, products.gram[..., 0])
    )
    cross, gram = np.ravel(cross), np.ravel(gram)
    found = weigh(products, Fitting(pooled=True), DECLARED)
    logs = []
    for strength in DECLARED.strengths:

        def log_density(weight: float, strength: float = strength) -> float:
            left = energy - 2 * weight * cross + weight**2 * gram
            return float(-150 * np.log(left / energy).sum() + stats.norm.logpdf(weight, scale=strength))

        grid = np.linspace(-1, 1, 2001)
        top = max(map(log_density, grid))
        area = integrate.simpson([np.exp(log_density(weight) - top) for weight in grid], x=grid)
        logs.append(top + np.log(area))
    expected = special.logsumexp(logs) - np.log(len(logs))
    assert found.log_evidence == pytest.approx(expected, abs=0.1)


def test_a_fixed_form_pays_for_what_moved_the_inputs(draw: Draw) -> None:
    products = draw(6, base_size=0)
    base, values = products.base, regressors(products, 6)
    target = base.target.values[:, :, 0]
    after = ((target - values.sum(axis=2)) ** 2).sum(axis=1)
    expected = -0.5 * base.bins * np.log(after / (target**2).sum(axis=1))
    found = weigh(products, Fitting(fixed=True, beforehand=3), DECLARED)
    np.testing.assert_allclose(found.by_channel, expected)
    assert found.log_evidence == pytest.approx(expected.sum() - 1.5 * np.log(base.bins))


@pytest.mark.parametrize("pooled", [False, True])
def test_a_form_with_weights_pays_for_what_was_fitted_beforehand(draw: Draw, pooled: bool) -> None:
    products = draw(8)
    free = weigh(products, Fitting(pooled=pooled), DECLARED).log_evidence
    found = weigh(products, Fitting(pooled=pooled, beforehand=5), DECLARED).log_evidence
    assert found == pytest.approx(free - 2.5 * np.log(products.base.bins))


def test_channels_that_may_not_change_do_not_count(draw: Draw) -> None:
    allowed = np.arange(21) % 3 == 0
    for fitting in (Fitting(allowed=allowed), Fitting(allowed=allowed, pooled=True)):
        products = draw(7)
        found = weigh(products, fitting, DECLARED)
        changed = replace(products, cross=np.where(allowed[:, None], products.cross, 0.0))
        assert weigh(changed, fitting, DECLARED).log_evidence == pytest.approx(found.log_evidence)
        assert not found.changes[~allowed].any()


def test_choosing_among_regressors_has_its_price(draw: Draw) -> None:
    products = draw(9)
    plain, chosen = (weigh(products, Fitting(choices=choices), DECLARED) for choices in (1, 20))
    np.testing.assert_allclose(chosen.by_channel, plain.by_channel - np.log(20))


def test_what_the_model_gets_wrong_anyway_is_no_evidence(draw: Draw) -> None:
    products = draw(10)
    for fitting in (Fitting(), Fitting(pooled=True), Fitting(fixed=True)):
        plain = weigh(products, fitting, DECLARED)
        less = weigh(products, fitting, DECLARED, np.full(21, 0.5))
        assert less.log_evidence < plain.log_evidence
    pooled = Fitting(pooled=True)
    found = [weigh(products, pooled, DECLARED, usual).log_evidence for usual in (0.0, 0.5)]
    assert found[0] - found[1] == pytest.approx(21 * 0.5)


def test_what_rounding_leaves_is_no_evidence() -> None:
    """A residual far below the steps of the counts says nothing, however well it is explained."""
    random = np.random.default_rng(1)
    values = random.normal(size=(21, 100, 1))
    fold = np.sort(np.arange(100) % 8)
    none = Design(np.empty((21, 100, 0)), fold)
    found = [
        weigh(
            Products.of(
                Base(Design(1e-3 * values, fold), none, np.empty((21, 0)), np.full(21, quantum)),
                Design(values, fold),
            ),
            Fitting(),
            DECLARED,
        ).log_evidence
        for quantum in (0.0, 1.0)
    ]
    assert found[0] > 100
    assert found[1] < 0


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 999), factor=st.floats(0.01, 100.0), pooled=st.booleans())
def test_the_scale_does_not_matter(draw: Draw, seed: int, factor: float, pooled: bool) -> None:
    """The prior is relative to the noise, or, where weights are pooled, to the regressors' size."""
    products = draw(seed, quantum=0.1)
    base, design = products.base, Design(regressors(products, seed), products.base.target.fold)
    larger = Base(
        Design(factor * base.target.values, design.fold),
        base.design,
        base.precision,
        base.quantum * factor**2,
    )
    if pooled:
        design = Design(factor * design.values, design.fold)
    fitting = Fitting(pooled=pooled)
    found = weigh(Products.of(larger, design), fitting, DECLARED).log_evidence
    assert found == pytest.approx(weigh(products, fitting, DECLARED).log_evidence, rel=1e-6, abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 999), pooled=st.booleans())
def test_the_order_of_channels_and_of_a_folds_bins_does_not_matter(
    draw: Draw, seed: int, pooled: bool
) -> None:
    products = draw(seed, quantum=0.05)
    base, values, fold = products.base, regressors(products, seed), products.base.target.fold
    random = np.random.default_rng(seed)
    channels = random.permutation(21)
    bins = np.concatenate([random.permutation(np.flatnonzero(fold == each)) for each in np.unique(fold)])

    def turned(part: np.ndarray) -> Design:
        return Design(part[channels][:, bins], fold)

    other = Base(
        turned(base.target.values), turned(base.design.values), base.precision[channels], base.quantum
    )
    fitting = Fitting(pooled=pooled)
    found = weigh(Products.of(other, turned(values)), fitting, DECLARED)
    expected = weigh(products, fitting, DECLARED)
    assert found.log_evidence == pytest.approx(expected.log_evidence, rel=1e-6, abs=1e-6)
    np.testing.assert_allclose(found.included, expected.included[channels], atol=1e-6)


@pytest.mark.parametrize("base_size", [0, 2])
def test_posterior_weights_are_those_of_ridge_regression(draw: Draw, base_size: int) -> None:
    products = draw(11, base_size=base_size, quantum=0.1)
    weighed = weigh(products, Fitting(), DECLARED)
    kept = np.array([True, False, True, True])
    beside, weights = posterior_weights(products, Fitting(), weighed, kept)
    base, own = products.base, regressors(products, 11)
    rows = kept[base.target.fold]
    for channel in range(21):
        values = np.concatenate([base.design.values[channel], own[channel]], axis=1)[rows]
        precision = np.diag([4.0] * base_size + [weighed.strength**-2] * 2)
        if not weighed.changes[channel]:
            values[:, base_size:] = 0.0
        expected = np.linalg.solve(
            values.T @ values + precision, values.T @ base.target.values[channel, rows, 0]
        )
        np.testing.assert_allclose([*beside[channel], *weights[channel]], expected, atol=1e-9)


@pytest.mark.parametrize("kept", [[], [2], [3, 0]])
def test_products_of_some_regressors_are_those_of_a_design_of_them(draw: Draw, kept: list[int]) -> None:
    every = draw(12, size=4)
    found = every.of_some(kept)
    expected = Products.of(every.base, Design(every.design.values[..., kept], every.design.fold))
    for name in ("between", "gram", "cross"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-9)

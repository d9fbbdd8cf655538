"""Least squares on blocks against least squares on rows."""

from itertools import pairwise
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from sklearn.linear_model import LinearRegression
from taxel_models.loop.statistics import RIDGE, Fitting, SufficientStatistics

from taxel_models.loop.basis import Own, Shared
from taxel_models.loop.blocks import Blocks

BLOCKS: Final = 24
LENGTH: Final = 60
ROWS: Final = BLOCKS * LENGTH
CHANNELS: Final = 21


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(1)


@pytest.fixture
def blocks() -> Blocks:
    """A quarter to evaluate on, three folds, and a guard row at each end of a block."""
    of_row = np.repeat(np.arange(BLOCKS), LENGTH)
    of_row[::LENGTH] = of_row[LENGTH - 1 :: LENGTH] = -1
    return Blocks(of_row, np.arange(BLOCKS) % 4 - 1)


@pytest.fixture
def features(random: np.random.Generator) -> NDArray[np.float64]:
    return random.normal(size=(ROWS, 3)) * [1.0, 20.0, 0.1]


@pytest.fixture
def row_weights(random: np.random.Generator) -> NDArray[np.float64]:
    return random.uniform(0.2, 3.0, ROWS)


@pytest.fixture
def residual(random: np.random.Generator, features: NDArray[np.float64]) -> NDArray[np.float64]:
    """The features with weights of each channel, noise, and nonsense in the first rows of blocks."""
    weights = random.normal(size=(3, CHANNELS)) * [[5.0], [0.5], [40.0]]
    found = features @ weights + random.normal(size=(ROWS, CHANNELS)) * np.linspace(1, 9, CHANNELS)
    found[::LENGTH] = 1e4
    return np.asarray(found)


def ridge_of_rows(
    values: NDArray[np.float64], target: NDArray[np.float64], counted: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Weighted least squares with a ridge of a share of each regressor's energy, on the rows themselves."""
    root = np.sqrt(counted)
    ridge = np.diag(np.sqrt(RIDGE * (values**2 * counted[:, None]).sum(axis=0)))
    augmented = np.vstack([values * root[:, None], ridge])
    return np.linalg.lstsq(augmented, np.concatenate([target * root, np.zeros(len(ridge))]), rcond=None)[0]


def shrunk(
    statistics: SufficientStatistics, scale: NDArray[np.float64], kept: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """(21,) the positive-part James-Stein factor by the F of some blocks."""
    return np.asarray(np.maximum(0.0, 1.0 - 1.0 / statistics.strength(scale, kept)))


def test_weights_are_those_of_the_fit_rows_and_no_other(
    features: NDArray[np.float64],
    residual: NDArray[np.float64],
    row_weights: NDArray[np.float64],
    blocks: Blocks,
) -> None:
    statistics = SufficientStatistics.of(Shared(features), residual, row_weights, blocks, Fitting())
    scale = np.ones(CHANNELS)
    found = statistics.weights(scale)
    factor = shrunk(statistics, scale, np.ones(18, bool))
    assert factor.min() > 0.5
    fit = blocks.fit
    for channel in (0, 7, 20):
        expected = ridge_of_rows(features[fit], residual[fit, channel], row_weights[fit])
        np.testing.assert_allclose(found[channel], expected * factor[channel], rtol=1e-6)
    plain = LinearRegression(fit_intercept=False).fit(features[fit], residual[fit], row_weights[fit])
    differences = features[fit] @ (found / factor[:, None] - plain.coef_).T
    assert (differences.std(axis=0) < 0.003 * plain.predict(features[fit]).std(axis=0)).all()


def test_regressors_of_each_channel_are_its_own(
    random: np.random.Generator, row_weights: NDArray[np.float64], blocks: Blocks
) -> None:
    values = random.normal(size=(ROWS, CHANNELS, 2)).astype(np.float32)
    residual = np.einsum("nck,k->nc", values, [3.0, -2.0]) + random.normal(size=(ROWS, CHANNELS))
    statistics = SufficientStatistics.of(Own(values), residual, row_weights, blocks, Fitting())
    scale = np.ones(CHANNELS)
    factor = shrunk(statistics, scale, np.ones(18, bool))
    fit = blocks.fit
    for channel in (0, 13):
        own = values[fit, channel].astype(np.float64)
        expected = ridge_of_rows(own, residual[fit, channel], row_weights[fit])
        np.testing.assert_allclose(
            statistics.weights(scale)[channel], expected * factor[channel], rtol=1e-6
        )


def test_a_shape_scales_the_shared_regressors(random: np.random.Generator, blocks: Blocks) -> None:
    features, shape = random.normal(size=(ROWS, 2)), random.normal(size=(ROWS, CHANNELS))
    shaped = Shared(features, shape)
    own = Own((shape[:, :, None] * features[:, None]).astype(np.float32))
    weights = random.normal(size=(CHANNELS, 2))
    np.testing.assert_allclose(shaped.times(weights), own.times(weights), rtol=1e-5, atol=1e-5)
    rows = np.array([3, 5, 700])
    np.testing.assert_allclose(shaped.at(rows), own.at(rows), rtol=1e-5, atol=1e-6)
    residual, row_weights, scale = random.normal(size=(ROWS, CHANNELS)), np.ones(ROWS), np.ones(CHANNELS)
    first, second = (
        SufficientStatistics.of(basis, residual, row_weights, blocks, Fitting()).weights(scale)
        for basis in (shaped, own)
    )
    np.testing.assert_allclose(first, second, rtol=1e-4, atol=1e-6)


def test_pooled_weights_are_one_regression_over_all_allowed_channels(
    features: NDArray[np.float64],
    residual: NDArray[np.float64],
    row_weights: NDArray[np.float64],
    blocks: Blocks,
) -> None:
    allowed = np.zeros((CHANNELS, 3), bool)
    allowed[2:] = True
    fitting = Fitting(pooled=True, allowed=allowed)
    statistics = SufficientStatistics.of(Shared(features), residual, row_weights, blocks, fitting)
    scale = np.linspace(0.1, 2.0, CHANNELS)
    found = statistics.weights(scale)
    fit, columns = blocks.fit, np.arange(2, CHANNELS)
    stacked = np.vstack([features[fit]] * len(columns))
    target = residual[fit][:, columns].T.ravel()
    counted = np.concatenate([row_weights[fit] * scale[column] for column in columns])
    factor = shrunk(statistics, scale, np.ones(18, bool))
    expected = ridge_of_rows(stacked, target, counted)
    np.testing.assert_allclose(found[2:], expected * factor[2:, None], rtol=1e-6)
    assert not found[:2].any()
    np.testing.assert_allclose(found[2:], found[2:3].repeat(19, axis=0), rtol=1e-12)


def test_fixed_weights_are_one(features: NDArray[np.float64], blocks: Blocks) -> None:
    statistics = SufficientStatistics.of(
        Shared(features[:, :1]), np.ones((ROWS, CHANNELS)), np.ones(ROWS), blocks, Fitting(fixed=True)
    )
    np.testing.assert_array_equal(statistics.weights(np.ones(CHANNELS)), np.ones((CHANNELS, 1)))


def test_gains_are_those_of_fitting_anew_and_predicting_what_was_left_out(
    features: NDArray[np.float64],
    residual: NDArray[np.float64],
    row_weights: NDArray[np.float64],
    blocks: Blocks,
) -> None:
    statistics = SufficientStatistics.of(Shared(features), residual, row_weights, blocks, Fitting())
    scale = np.linspace(0.5, 2.0, CHANNELS)
    gains = statistics.gains(scale)
    assert gains.shape == (3, CHANNELS)
    folds = blocks.fold[blocks.fold >= 0]
    for fold in range(3):
        of_fold = blocks.fit & (blocks.fold[blocks.of_row] == fold)
        others = blocks.fit & ~of_fold
        factor = shrunk(statistics, scale, folds != fold)
        for channel in (0, 20):
            weights = ridge_of_rows(features[others], residual[others, channel], row_weights[others])
            target = residual[of_fold, channel]
            after = target - features[of_fold] @ weights * factor[channel]
            fall = ((target**2 - after**2) * row_weights[of_fold]).sum() * scale[channel]
            np.testing.assert_allclose(gains[fold, channel], fall, rtol=1e-7)


def test_gains_may_be_tested_on_rows_counted_otherwise(
    features: NDArray[np.float64], residual: NDArray[np.float64], blocks: Blocks
) -> None:
    fitted, doubled = (
        SufficientStatistics.of(Shared(features), residual, np.full(ROWS, weight), blocks, Fitting())
        for weight in (1.0, 2.0)
    )
    scale = np.ones(CHANNELS)
    np.testing.assert_allclose(fitted.gains(scale, tested=doubled), 2 * fitted.gains(scale), rtol=1e-12)


def test_strength_is_hotellings_f_of_the_blocks_scores(
    random: np.random.Generator, row_weights: NDArray[np.float64], blocks: Blocks
) -> None:
    features = random.normal(size=(ROWS, 3))
    residual = random.normal(size=(ROWS, CHANNELS)) + features @ random.normal(size=(3, CHANNELS)) * 0.1
    statistics = SufficientStatistics.of(Shared(features), residual, row_weights, blocks, Fitting())
    found = statistics.strength(np.ones(CHANNELS))
    numbers = np.flatnonzero(blocks.fold >= 0)
    for channel in (0, 4, 20):
        scores = np.array(
            [
                features[rows].T @ (residual[rows, channel] * row_weights[rows])
                for rows in (blocks.of_row == number for number in numbers)
            ]
        )
        count, size = scores.shape
        mean = scores.mean(axis=0)
        squared = count * mean @ np.linalg.solve(np.cov(scores.T), mean)
        np.testing.assert_allclose(
            found[channel], (count - size) / (size * (count - 1)) * squared, rtol=1e-4
        )


def test_strength_of_noise_has_the_f_distribution(blocks: Blocks) -> None:
    found = []
    for seed in range(25):
        random = np.random.default_rng(seed)
        features = random.normal(size=(ROWS, 2))
        # What rows of a block share must not count as observations.
        shared = np.repeat(random.normal(size=(BLOCKS, CHANNELS)), LENGTH, axis=0)
        residual = random.normal(size=(ROWS, CHANNELS)) + shared
        statistics = SufficientStatistics.of(Shared(features), residual, np.ones(ROWS), blocks, Fitting())
        found.append(statistics.strength(np.ones(CHANNELS)))
    assert stats.kstest(np.concatenate(found), stats.f(2, 18 - 2).cdf).pvalue > 1e-3


def test_signs_turn_the_residual_of_blocks_round(
    features: NDArray[np.float64], residual: NDArray[np.float64], blocks: Blocks
) -> None:
    statistics = SufficientStatistics.of(Shared(features), residual, np.ones(ROWS), blocks, Fitting())
    signs = np.ones((2, 18))
    signs[1, ::2] = -1.0
    scale = np.ones(CHANNELS)
    turned = residual.copy()
    for number in np.flatnonzero(blocks.fold >= 0)[::2]:
        turned[blocks.of_row == number] *= -1.0
    expected = SufficientStatistics.of(Shared(features), turned, np.ones(ROWS), blocks, Fitting()).strength(
        scale
    )
    first, second = statistics.strengths(scale, signs)
    np.testing.assert_allclose(first, statistics.strength(scale))
    np.testing.assert_allclose(second, expected, rtol=1e-9)


def test_noise_alone_gets_small_weights(random: np.random.Generator, blocks: Blocks) -> None:
    features = random.normal(size=(ROWS, 2))
    residual = random.normal(size=(ROWS, CHANNELS))
    statistics = SufficientStatistics.of(Shared(features), residual, np.ones(ROWS), blocks, Fitting())
    strength, weights = statistics.strength(np.ones(CHANNELS)), statistics.weights(np.ones(CHANNELS))
    assert (strength < 1.0).any()
    assert not weights[strength < 1.0].any()
    plain = features[blocks.fit].T @ residual[blocks.fit] / blocks.fit.sum()
    assert (weights**2).sum() < 0.6 * (plain**2).sum()


def test_a_basis_of_some_rows_takes_those_of_the_residual(
    features: NDArray[np.float64], residual: NDArray[np.float64], blocks: Blocks
) -> None:
    some = np.arange(0, ROWS, 7)
    values = np.repeat(features[some][:, None], CHANNELS, axis=1).astype(np.float32)
    statistics = SufficientStatistics.of(Own(values, some), residual, np.ones(ROWS), blocks, Fitting())
    kept = some[blocks.fit[some]]
    np.testing.assert_allclose(statistics.energy.sum(axis=0), (residual[kept] ** 2).sum(axis=0), rtol=1e-9)
    np.testing.assert_allclose(
        statistics.cross.sum(axis=0), (features[kept].T @ residual[kept]).T, rtol=1e-4, atol=0.1
    )


def test_blocks_statistics_stay_apart(
    features: NDArray[np.float64], residual: NDArray[np.float64], blocks: Blocks
) -> None:
    statistics = SufficientStatistics.of(Shared(features), residual, np.ones(ROWS), blocks, Fitting())
    numbers = np.flatnonzero(blocks.fold >= 0)
    assert statistics.folds == 3
    for place, (number, after) in enumerate(pairwise([*numbers, BLOCKS])):
        assert number < after
        rows = blocks.of_row == number
        np.testing.assert_allclose(statistics.energy[place], (residual[rows] ** 2).sum(axis=0))
        np.testing.assert_allclose(statistics.regressors[place, 0], features[rows].T @ features[rows])

"""Scores against their definitions."""

from dataclasses import replace
from typing import Final

import numpy as np
import pytest
from scipy import stats
from taxel_models.loop.cross_validation import (
    MOST_ROW_WEIGHT,
    Score,
    absolute_of,
    cross_validate,
    random_signs,
    row_weights_of,
    scale_of,
    stands_out,
    worth,
)
from taxel_models.loop.statistics import Fitting, SufficientStatistics

from taxel_models.loop.basis import Shared
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.effects.effect import Candidate

BLOCKS: Final = 30
LENGTH: Final = 50
ROWS: Final = BLOCKS * LENGTH


def statistics_of(seed: int, strength: float) -> SufficientStatistics:
    """One regressor, and a residual that it explains a part of in one channel of 21."""
    random = np.random.default_rng(seed)
    feature, residual = random.normal(size=(ROWS, 1)), random.normal(size=(ROWS, 21))
    residual[:, 3] += strength * feature[:, 0]
    blocks = Blocks(np.repeat(np.arange(BLOCKS), LENGTH), np.arange(BLOCKS) % 5)
    return SufficientStatistics.of(Shared(feature), residual, np.ones(ROWS), blocks, Fitting())


def scored(statistics: SufficientStatistics, **fitting: bool) -> Score:
    candidate = Candidate("one", "a form", Shared(np.zeros((ROWS, 1))), fitting=Fitting(**fitting))
    return cross_validate(candidate, statistics, np.ones(21))


def test_the_resampled_t_test_is_the_plain_one_with_a_wider_spread() -> None:
    score = scored(statistics_of(0, 0.5))
    shares = score.fold_share
    assert len(shares) == 5
    statistic = stats.ttest_1samp(shares, 0.0).statistic
    # Nadeau and Bengio: 1/folds + test/train in the place of 1/folds, and here test/train is 1/4.
    corrected = statistic * np.sqrt((1 / 5) / (1 / 5 + 1 / 4))
    assert score.t_test == pytest.approx(float(stats.t.sf(corrected, 4)))
    assert 0.0 < score.t_test < 0.05


def test_what_one_channel_shows_in_every_fold_repeats() -> None:
    shares = np.random.default_rng(0).normal(0.0, 0.05, (8, 21))
    among_noise = replace(
        scored(statistics_of(0, 0.25)), channel_share=shares, fold_share=shares.mean(axis=1)
    )
    assert among_noise.repeats > 0.1
    shares[:, 3] += 0.2
    shown = replace(among_noise, channel_share=shares, fold_share=shares.mean(axis=1))
    # By itself it is clear, among twenty channels of noise it is less so.
    assert shown.repeats < 0.01 < shown.t_test
    # Over all channels it has to lean the same way.
    against = replace(shown, fold_share=-shown.fold_share)
    assert against.repeats == against.t_test / 4 > 0.2
    pooled = replace(shown, candidate=replace(shown.candidate, fitting=Fitting(pooled=True)))
    assert pooled.repeats == pooled.t_test


def test_noise_repeats_about_as_seldom_as_the_test_says() -> None:
    found = np.array([scored(statistics_of(seed, 0.0)).repeats for seed in range(200)])
    assert (found < 0.025).mean() <= 0.05


def test_weights_contradict_a_cause_that_would_have_them_alike() -> None:
    score = scored(statistics_of(0, 2.0))
    assert score.unlikeness(np.ones(21)) > 1.0
    assert not score.contradicts(np.ones(21))
    for alike, contradicts in ((0.35, True), (100.0, False)):
        other = replace(score, candidate=replace(score.candidate, alike=alike))
        assert other.contradicts(np.ones(21)) == contradicts


def test_shares_are_of_the_residuals_energy() -> None:
    score = scored(statistics_of(0, 2.0))
    # Of 21 channels with energy 1, one has 4 more, which is explained.
    assert score.share == pytest.approx(4.0 / 25.0, rel=0.1)
    assert score.fold_share.mean() == pytest.approx(score.share, rel=0.05)
    assert score.channels[3]


def test_what_explains_nothing_has_no_share() -> None:
    shares = [scored(statistics_of(seed, 0.0)).share for seed in range(10)]
    assert max(shares) < 0.005
    assert np.mean(shares) < 0.001


def test_freedom_counts_what_is_fitted_and_what_is_settled() -> None:
    statistics = statistics_of(0, 0.0)
    assert scored(statistics).freedom == 21
    assert scored(statistics, pooled=True).freedom == 1
    assert scored(statistics, fixed=True).freedom == 0
    shaped = Candidate("one", "a form", Shared(np.zeros((ROWS, 2))), form_parameters={"tau": (1.0, "s")})
    assert cross_validate(shaped, statistics, np.ones(21)).freedom == 43


def test_scale_makes_every_channel_count_alike() -> None:
    residual = np.random.default_rng(0).normal(size=(5000, 21)) * np.linspace(1, 50, 21) + 3.0
    scaled = residual**2 * scale_of(residual)
    np.testing.assert_allclose(scaled.mean(axis=0), 1.0)
    assert np.isfinite(scale_of(np.zeros((10, 21)))).all()


def test_rows_count_less_where_the_residual_scatters_more() -> None:
    random = np.random.default_rng(0)
    pressed = random.uniform(0.0, 8.0, 20_000)
    residual = random.normal(size=(20_000, 21)) * (1.0 + pressed[:, None])
    fit = random.random(20_000) < 0.7
    residual[~fit] *= 1000.0
    residual[~fit, 0] = 0.0
    row_weights = row_weights_of(residual, pressed, fit)
    assert row_weights[fit].mean() == pytest.approx(1.0)
    assert row_weights.min() > 0.0
    light, hard = (row_weights[fit & (abs(pressed - force) < 0.5)].mean() for force in (0.5, 7.5))
    assert 5.0 < light / hard <= MOST_ROW_WEIGHT**2


def test_a_row_far_outside_its_bin_counts_less() -> None:
    random = np.random.default_rng(0)
    residual = random.normal(size=(4000, 21))
    residual[17] *= 30.0
    row_weights = row_weights_of(residual, np.ones(4000), np.ones(4000, bool))
    assert row_weights[17] < 0.3 * np.median(row_weights)


def test_absolute_weights_turn_squares_into_sizes() -> None:
    random = np.random.default_rng(0)
    residual = random.normal(size=(4000, 21)) * random.uniform(1.0, 5.0, (4000, 1))
    fit = np.ones(4000, bool)
    size = np.sqrt((residual**2 * scale_of(residual)).mean(axis=1))
    counted = absolute_of(residual, fit) * size**2
    large = size > np.quantile(size, 0.1)
    np.testing.assert_allclose(counted[large], size[large])
    assert (counted <= size + 1e-12).all()


def test_worth_is_the_share_of_each_channels_first_error() -> None:
    statistics = statistics_of(0, 1.0)
    score = scored(statistics)
    first = statistics.energy.sum(axis=0)
    found = worth(score, statistics, np.ones(21), first)
    np.testing.assert_allclose(found, statistics.gains(np.ones(21)).sum(axis=0) / first)
    assert found[3] == pytest.approx(0.5, abs=0.05)


def test_one_channel_of_many_stands_out() -> None:
    signs = random_signs(199, BLOCKS, 0)
    found = stands_out(statistics_of(0, 0.5), np.ones(21), signs)
    assert found.shape == (200,)
    assert found[0] > found[1:].max()


def test_noise_stands_out_as_often_as_chance_has_it() -> None:
    signs = random_signs(99, BLOCKS, 0)
    ranks = []
    for seed in range(80):
        found = stands_out(statistics_of(seed, 0.0), np.ones(21), signs)
        ranks.append((1 + (found[1:] >= found[0]).sum()) / 100)
    assert stats.kstest(ranks, "uniform").pvalue > 1e-3


def test_signs_are_drawn_by_the_seed() -> None:
    signs = random_signs(50, 40, 3)
    assert signs.shape == (50, 40)
    assert set(np.unique(signs)) == {-1.0, 1.0}
    np.testing.assert_array_equal(signs, random_signs(50, 40, 3))
    assert (signs != random_signs(50, 40, 4)).any()

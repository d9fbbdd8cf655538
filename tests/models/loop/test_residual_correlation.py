"""Correlations of a residual beside those of statsmodels and SciPy, and their bands."""

import numpy as np
import pytest
from scipy.signal import correlate, lfilter
from statsmodels.tsa.stattools import acf

from taxel.channels import CHANNELS
from taxel_models.loop.blocks import Blocks, cut
from taxel_models.loop.observations import Observations
from taxel_models.loop.residual_correlation import autocorrelations, cross_correlations

ROWS = np.s_[1_000:5_000]


def some_rows(observations: Observations) -> np.ndarray:
    """One stretch inside a segment."""
    rows = np.zeros(len(observations), bool)
    rows[ROWS] = True
    assert len(np.unique(observations.segment[rows])) == 1
    return rows


@pytest.fixture
def white(observations: Observations) -> np.ndarray:
    return np.random.default_rng(1).normal(size=observations.predicted.shape)


def test_autocorrelation_is_that_of_statsmodels(observations: Observations, white: np.ndarray) -> None:
    rows = some_rows(observations)
    coloured = 3.0 + lfilter([1.0], [1.0, -0.95], white, axis=0)
    found = autocorrelations(observations, coloured, white, rows)
    ticks = np.rint(np.array(found.lags_s) * 100).astype(int)
    assert ticks[0] == 1
    for place, name in enumerate(CHANNELS):
        for values, residual in ((found.before, coloured), (found.after, white)):
            expected = acf(residual[rows, place], adjusted=True, nlags=500, fft=False)[ticks]
            np.testing.assert_allclose(values[name], expected, atol=2e-4)


def test_the_band_holds_white_noise(observations: Observations, white: np.ndarray) -> None:
    found = autocorrelations(observations, white, white, np.ones(len(observations), bool))
    inside = np.abs([found.after[name] for name in CHANNELS]) <= np.array(found.band)
    # 252 values, 99 % of which lie inside on average.
    assert 0.97 <= inside.mean() < 1.0


def test_cross_correlation_is_that_of_scipy(observations: Observations, white: np.ndarray) -> None:
    rows = some_rows(observations)
    blocks = Blocks(np.where(rows, np.arange(len(rows)) // 100, -1), np.full(len(rows) // 100 + 1, -1))
    force = observations.force[:, 0]
    late = np.roll(force, 20)[:, None] + 0.5 * force.std() * white
    found = next(
        one for one in cross_correlations(observations, blocks, late, white) if one.input == "force x"
    )
    ticks = np.rint(np.array(found.lags_s) * 100).astype(int)
    residual, own = (values[rows] - values[rows].mean(axis=0) for values in (late, force))
    for place, name in enumerate(CHANNELS):
        sums = correlate(residual[:, place], own)[len(own) - 1 :][ticks]
        expected = sums / (len(own) - ticks) / residual[:, place].std() / own.std()
        np.testing.assert_allclose(found.before[name], expected, atol=2e-4)
        assert ticks[np.argmax(found.before[name])] == 20
        assert max(found.before[name]) > found.band_before[name]


def test_a_residual_that_is_steady_within_blocks_and_independent_of_the_input_stays_in_its_band(
    observations: Observations, white: np.ndarray
) -> None:
    """A band for independent rows would hold a few of these: neighbouring rows err alike."""
    blocks = cut(observations, seed=0, held_out=0.6)
    own = np.random.default_rng(2).normal(size=(len(blocks), len(CHANNELS)))
    steady = own[blocks.of_row] + 0.1 * white
    found = cross_correlations(observations, blocks, steady, white)
    assert len(found) == 7
    at_once = np.array([[one.before[name][0] for name in CHANNELS] for one in found])
    bands = np.array([[one.band_before[name] for name in CHANNELS] for one in found])
    assert (np.abs(at_once) <= bands).mean() >= 0.95
    independent = 2.576 / np.sqrt(blocks.evaluation.sum())
    assert (np.abs(at_once) <= independent).mean() < 0.6

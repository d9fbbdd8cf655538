"""Spectra of stretches with gaps between them."""

import numpy as np
import pytest

from taxel_models.loop.observations import Observations
from taxel_models.loop.spectrum import power_density, stretches

SD = 8.0


def test_stretches_are_of_wanted_rows_inside_segments(observations: Observations) -> None:
    rows = np.ones(len(observations), bool)
    assert stretches(observations, rows) == [slice(0, len(rows))]
    rows[:100] = rows[5000:5010] = False
    assert stretches(observations, rows) == [slice(100, 5000), slice(5010, len(rows))]
    assert stretches(observations, ~rows) == [slice(0, 100), slice(5000, 5010)]


def test_white_noise_has_the_same_density_everywhere() -> None:
    white = np.random.default_rng(0).normal(size=(20_000, 21)) * SD
    frequencies, density = power_density(white, [slice(0, 12_000), slice(12_100, 20_000)], 256)
    assert density.shape == (len(frequencies), 21) == (129, 21)
    assert frequencies[-1] == pytest.approx(50.0)
    # All of the variance lies below 50 Hz.
    np.testing.assert_allclose(density[5:-5].mean(), SD**2 / 50.0, rtol=0.05)
    assert density.sum() * frequencies[1] / 21 == pytest.approx(SD**2, rel=0.05)


def test_a_long_stretch_counts_more_than_a_short_one() -> None:
    random = np.random.default_rng(1)
    left = np.concatenate([random.normal(size=(25_600, 1)), 10.0 * random.normal(size=(256, 1))])
    _, density = power_density(left, [slice(0, 25_600), slice(25_600, 25_856)], 256)
    pieces = 199
    assert density[5:-5].mean() * 50.0 == pytest.approx((pieces + 100.0) / (pieces + 1), rel=0.15)


def test_without_a_whole_piece_there_is_no_spectrum() -> None:
    frequencies, density = power_density(np.zeros((300, 21)), [slice(0, 200), slice(200, 300)], 256)
    assert (len(frequencies), density.shape) == (0, (0, 21))

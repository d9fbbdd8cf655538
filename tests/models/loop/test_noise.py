"""The noise floor on noise of a known size."""

from dataclasses import replace

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel_models.loop.noise import NoiseFloor
from taxel_models.loop.observations import Observations

SD = np.linspace(0.5, 40.0, 21)


def with_residual(observations: Observations, residual: np.ndarray) -> Observations:
    return replace(observations, measured=observations.predicted + residual)


@pytest.fixture
def white(observations: Observations) -> np.ndarray:
    return np.random.default_rng(0).normal(size=observations.predicted.shape) * SD


def test_white_noise_is_found_in_every_channel(observations: Observations, white: np.ndarray) -> None:
    noise = NoiseFloor.of(with_residual(observations, white))
    np.testing.assert_allclose(noise.differences, SD, rtol=0.07)
    np.testing.assert_allclose(noise.share(SD**2), 1.0, atol=0.1)
    np.testing.assert_allclose(noise.share(4 * SD**2), 0.25, atol=0.03)


def test_slow_causes_hardly_touch_it(observations: Observations, white: np.ndarray) -> None:
    slow = 200.0 * np.sin(2 * np.pi * 0.2 * observations.time_s)[:, None] + 50.0
    noise = NoiseFloor.of(with_residual(observations, white + slow))
    np.testing.assert_allclose(noise.differences, SD, rtol=0.07, atol=0.1)


def test_jumps_at_gaps_do_not_count(observations: Observations, white: np.ndarray) -> None:
    steps = np.repeat(np.random.default_rng(1).normal(size=len(observations) // 4 + 1) * 1e3, 4)
    cut = replace(observations, segment=np.arange(len(observations)) // 4)
    noise = NoiseFloor.of(with_residual(cut, white + steps[: len(observations), None]))
    np.testing.assert_allclose(noise.differences, SD, rtol=0.07)


def test_free_air_is_a_second_reading(observations: Observations, white: np.ndarray) -> None:
    quiet = np.where(observations.pressed[:, None] < 0.1, 0.5, 1.0)
    resting = replace(observations, measured=2000.0 + white * quiet, predicted=np.full_like(white, 2000.0))
    noise = NoiseFloor.of(resting)
    assert noise.resting is not None
    np.testing.assert_allclose(noise.resting, np.maximum(SD / 2, 1 / np.sqrt(12)), rtol=0.07)
    touched = resting.kept(observations.pressed > 0.2)
    assert NoiseFloor.of(touched).resting is None


def test_rounding_is_the_least(observations: Observations) -> None:
    noise = NoiseFloor.of(replace(observations, measured=observations.predicted))
    np.testing.assert_allclose(noise.differences, 1 / np.sqrt(12))


def test_the_report_has_the_mean_absolute_error_of_normal_noise(
    observations: Observations, white: np.ndarray
) -> None:
    noise = NoiseFloor.of(with_residual(observations, white))
    report = noise.report(4 * SD**2, np.full(21, 100.0))
    assert report["mae"] == pytest.approx(np.abs(white).mean(), rel=0.03)
    assert report["norm_mae"] == pytest.approx(report["mae"] / 100.0)
    assert report["share_of_residual_energy"] == pytest.approx(0.25, rel=0.05)
    assert tuple(report["per_channel"]) == CHANNELS


def test_a_wave_that_is_explained_is_no_noise(observations: Observations, white: np.ndarray) -> None:
    """Mains of 60 Hz look like 40 Hz at 100 samples a second, which second differences enlarge."""
    wave = np.sin(2 * np.pi * 40.0 * observations.time_s)[:, None] * np.linspace(0.0, 300.0, len(CHANNELS))
    recorded = with_residual(observations, white + wave)
    free = NoiseFloor.of(with_residual(observations, white))
    found = NoiseFloor.of(recorded, wave)
    np.testing.assert_allclose(found.differences, free.differences)
    assert NoiseFloor.of(recorded).differences[-1] > 5 * SD[-1]

"""Noise is told from structure, and a spectral line is found where it is."""

import numpy as np
import pytest
from scipy.signal import lfilter

from taxel.windows.history import TICK_S
from taxel_models.loop.findings import Unexplained
from taxel_models.loop.noise import NoiseFloor
from taxel_models.loop.observations import Observations
from taxel_models.loop.residual_diagnostics import PIECE_ROWS, autocorrelation, diagnose_residual

SD = 8.0
FLOOR = NoiseFloor(np.full(21, SD), None)


@pytest.fixture
def white(observations: Observations) -> np.ndarray:
    return np.random.default_rng(0).normal(size=observations.predicted.shape) * SD


def judged(observations: Observations, left: np.ndarray) -> Unexplained:
    return diagnose_residual(observations, left, FLOOR, np.ones(len(observations), bool))


def test_white_noise_is_noise(observations: Observations, white: np.ndarray) -> None:
    found = judged(observations, white)
    assert not found.structured
    assert found.hint == "indistinguishable from the channels' noise"
    assert found.share < 0.05
    assert abs(found.autocorrelation["10 ms"]) < 0.02
    assert abs(found.autocorrelation["1 s"]) < 0.02


def test_more_white_noise_than_expected_is_no_structure(
    observations: Observations, white: np.ndarray
) -> None:
    found = judged(observations, 2 * white)
    assert found.share == pytest.approx(0.75, abs=0.02)
    assert not found.structured


def test_an_autoregressive_residual_is_structured(observations: Observations, white: np.ndarray) -> None:
    left = lfilter([1.0], [1.0, -0.9], white, axis=0)
    found = judged(observations, left)
    assert found.structured
    assert found.autocorrelation["10 ms"] == pytest.approx(0.9, abs=0.02)
    assert found.autocorrelation["1 s"] == pytest.approx(0.9**100, abs=0.05)
    assert "periodic" not in found.hint


@pytest.mark.parametrize("frequency", [1.37, 2.9, 7.0])
def test_a_periodic_residual_is_told_by_its_frequency(
    observations: Observations, white: np.ndarray, frequency: float
) -> None:
    wave = 12.0 * np.sin(2 * np.pi * frequency * observations.time_s)
    found = judged(observations, white + wave[:, None])
    assert found.structured
    told = float(found.hint.split("periodic at ")[1].split(" Hz")[0])
    resolution = 1.0 / (PIECE_ROWS * TICK_S)
    assert told == pytest.approx(frequency, abs=0.6 * resolution)
    assert "as large in free air" in found.hint


def test_what_is_left_while_touched_is_told_apart(observations: Observations, white: np.ndarray) -> None:
    left = (
        lfilter([0.44], [1.0, -0.9], white, axis=0)
        * np.where(observations.pressed > 0.1, 5.0, 1.0)[:, None]
    )
    assert "while touched rather than in free air" in judged(observations, left).hint


def test_structure_in_two_channels_alone_is_structure(
    observations: Observations, white: np.ndarray
) -> None:
    left = white.copy()
    left[:, [4, 9]] += 15.0 * np.sin(observations.time_s)[:, None]
    found = judged(observations, left)
    assert found.structured
    assert "e3" in found.hint
    assert "e8" in found.hint


def test_rows_elsewhere_are_not_looked_at(observations: Observations, white: np.ndarray) -> None:
    rows = np.arange(len(observations)) < len(observations) // 2
    left = white.copy()
    left[~rows] += 500.0
    assert not diagnose_residual(observations, left, FLOOR, rows).structured


def test_autocorrelation_stays_inside_segments(observations: Observations, white: np.ndarray) -> None:
    rows = np.ones(len(observations), bool)
    assert autocorrelation(observations, white, rows, len(observations) + 5) == 0.0
    lagged = white.copy()
    lagged[3:] += white[:-3]
    assert autocorrelation(observations, lagged, rows, 3) == pytest.approx(0.5, abs=0.02)
    assert autocorrelation(observations, lagged, rows, 2) == pytest.approx(0.0, abs=0.02)

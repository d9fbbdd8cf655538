"""Noise is told from structure, and a spectral line is found where it is."""

import numpy as np
import pytest
from scipy.signal import lfilter

from taxel_models.loop.evidence import Evidence
from taxel_models.loop.findings import Unexplained
from taxel_models.loop.remainder import autocorrelation, remainder, spectrum

SD = 8.0


@pytest.fixture
def white(evidence: Evidence) -> np.ndarray:
    return np.random.default_rng(0).normal(size=evidence.predicted.shape) * SD


def judged(evidence: Evidence, left: np.ndarray) -> Unexplained:
    return remainder(evidence, left, np.full(21, SD), np.ones(len(evidence), bool))


def test_white_noise_is_noise(evidence: Evidence, white: np.ndarray) -> None:
    found = judged(evidence, white)
    assert not found.structured
    assert found.hint == "indistinguishable from the channels' noise"
    assert found.share < 0.05
    assert abs(found.autocorrelation["10 ms"]) < 0.02
    assert abs(found.autocorrelation["1 s"]) < 0.02


def test_more_white_noise_than_expected_is_no_structure(evidence: Evidence, white: np.ndarray) -> None:
    found = judged(evidence, 2 * white)
    assert found.share == pytest.approx(0.75, abs=0.02)
    assert not found.structured


def test_an_autoregressive_remainder_is_structured(evidence: Evidence, white: np.ndarray) -> None:
    left = lfilter([1.0], [1.0, -0.9], white, axis=0)
    found = judged(evidence, left)
    assert found.structured
    assert found.autocorrelation["10 ms"] == pytest.approx(0.9, abs=0.02)
    assert found.autocorrelation["1 s"] == pytest.approx(0.9**100, abs=0.05)
    assert "periodic" not in found.hint


@pytest.mark.parametrize("frequency", [1.37, 2.9, 7.0])
def test_a_periodic_remainder_is_told_by_its_frequency(
    evidence: Evidence, white: np.ndarray, frequency: float
) -> None:
    wave = 12.0 * np.sin(2 * np.pi * frequency * evidence.time_s)
    found = judged(evidence, white + wave[:, None])
    assert found.structured
    told = float(found.hint.split("periodic at ")[1].split(" Hz")[0])
    resolution = spectrum(evidence, white, np.ones(len(evidence), bool))[0][1]
    assert told == pytest.approx(frequency, abs=0.6 * resolution)
    assert "as large in free air" in found.hint


def test_what_is_left_while_touched_is_told_apart(evidence: Evidence, white: np.ndarray) -> None:
    left = lfilter([0.44], [1.0, -0.9], white, axis=0) * np.where(evidence.pressed > 0.1, 5.0, 1.0)[:, None]
    assert "while touched rather than in free air" in judged(evidence, left).hint


def test_structure_in_two_channels_alone_is_structure(evidence: Evidence, white: np.ndarray) -> None:
    left = white.copy()
    left[:, [4, 9]] += 15.0 * np.sin(evidence.time_s)[:, None]
    found = judged(evidence, left)
    assert found.structured
    assert "e3" in found.hint
    assert "e8" in found.hint


def test_rows_elsewhere_are_not_looked_at(evidence: Evidence, white: np.ndarray) -> None:
    rows = np.arange(len(evidence)) < len(evidence) // 2
    left = white.copy()
    left[~rows] += 500.0
    assert not remainder(evidence, left, np.full(21, SD), rows).structured


def test_autocorrelation_stays_inside_segments(evidence: Evidence, white: np.ndarray) -> None:
    rows = np.ones(len(evidence), bool)
    assert autocorrelation(evidence, white, rows, len(evidence) + 5) == 0.0
    lagged = white.copy()
    lagged[3:] += white[:-3]
    assert autocorrelation(evidence, lagged, rows, 3) == pytest.approx(0.5, abs=0.02)
    assert autocorrelation(evidence, lagged, rows, 2) == pytest.approx(0.0, abs=0.02)


def test_the_spectrum_is_of_whole_stretches(evidence: Evidence, white: np.ndarray) -> None:
    rows = np.ones(len(evidence), bool)
    frequencies, power = spectrum(evidence, white, rows)
    assert power.shape == (len(frequencies), 21)
    length = 2 * (len(frequencies) - 1)
    assert frequencies[-1] == pytest.approx(50.0)
    level = power[10:-10].mean()
    assert level == pytest.approx(SD**2 * (np.hanning(length) ** 2).sum(), rel=0.05)
    none, empty = spectrum(evidence, white, np.arange(len(rows)) % (length // 2) > 0)
    assert (len(none), empty.shape) == (0, (0, 21))

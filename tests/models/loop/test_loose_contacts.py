"""Which channels come and go: they leave for one level and come back while the others go on."""

from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel_models.loop.basis import Floats
from taxel_models.loop.loose_contacts import FEWEST_TIMES, SHORTEST, loose_contacts
from taxel_models.loop.stuck_at import StuckChannel

ROWS: Final = 8_000
E7: Final = CHANNELS.index("e7")
SEGMENT: Final = np.repeat(np.arange(10), ROWS // 10)


def pressed_and_slid(seed: int = 3) -> tuple[Floats, Floats]:
    """Measured and predicted counts of ten contacts; the model errs by a tenth."""
    random = np.random.default_rng(seed)
    phase = np.tile(np.linspace(0.0, 1.0, ROWS // 10), 10)
    load = np.clip(5.0 * np.minimum(phase, 1.0 - phase), 0.0, 1.0)
    slides = load * (1.0 + 0.3 * np.sin(2 * np.pi * np.arange(ROWS) / 90.0))
    signal = slides[:, None] * np.linspace(20.0, 80.0, len(CHANNELS))
    noise = 0.4 * random.standard_normal(signal.shape)
    return np.rint(2500.0 + signal + noise), 2500.0 + 0.9 * signal


def absences(times: int, seed: int = 5) -> NDArray[np.bool_]:
    """Rows within contacts in which a wire is loose, 10 to 60 at a time."""
    random = np.random.default_rng(seed)
    away = np.zeros(ROWS, np.bool_)
    for number in range(times):
        start = 800 * (number % 10) + 170 + int(random.integers(100)) + 140 * (number // 10 % 3)
        away[start : start + int(random.integers(10, 60))] = True
    return away


def found(measured: Floats, predicted: Floats) -> list[StuckChannel]:
    return loose_contacts(measured, predicted, SEGMENT)


def test_healthy_channels_do_not_come_and_go() -> None:
    assert found(*pressed_and_slid()) == []


@pytest.mark.parametrize(("level", "noise"), [(2500.0, 0.0), (2500.0, 0.5), (0.0, 0.0), (2300.0, 2.0)])
def test_a_loose_channel_is_found_whatever_it_falls_to(level: float, noise: float) -> None:
    measured, predicted = pressed_and_slid()
    away = absences(20)
    random = np.random.default_rng(1)
    measured[away, E7] = np.rint(level + noise * random.standard_normal(int(away.sum())))
    (loose,) = found(measured, predicted)
    assert (loose.channel, loose.kind) == (E7, "intermittent")
    assert abs(loose.value - level) <= 4
    assert (loose.rows & away).sum() > 0.6 * away.sum()
    assert not (loose.rows & ~away).any()


def test_a_few_times_are_not_enough() -> None:
    measured, predicted = pressed_and_slid()
    away = absences(FEWEST_TIMES - 1)
    measured[away, E7] = 2500.0
    assert found(measured, predicted) == []


def test_taps_move_all_channels_at_once() -> None:
    random = np.random.default_rng(2)
    tapped = np.repeat(random.random(ROWS // 20) < 0.4, 20)
    signal = tapped[:, None] * np.linspace(20.0, 80.0, len(CHANNELS))
    noise = 0.4 * random.standard_normal(signal.shape)
    assert found(np.rint(2500.0 + signal + noise), np.full_like(signal, 2500.0) + 0.3 * signal) == []


def test_a_resting_channel_with_bursts_is_only_noisy() -> None:
    measured, predicted = pressed_and_slid()
    random = np.random.default_rng(6)
    bursts = np.repeat(random.random(ROWS // 10) < 0.3, 10)
    predicted[:, E7] = 2500.0
    measured[:, E7] = 2500.0 + np.where(bursts, 60.0, 0.0)
    assert found(measured, predicted) == []


def test_spikes_are_no_return() -> None:
    measured, predicted = pressed_and_slid()
    measured[:, E7], predicted[:, E7] = 2500.0, 2540.0
    measured[:: SHORTEST + 10, E7] = 2600.0
    assert found(measured, predicted) == []


@pytest.mark.parametrize("play", [6.0, 12.0, 20.0])
def test_channels_that_stick_and_follow_come_back_by_no_jump(play: float) -> None:
    """Most of their steps are 0, so that those of their movements are large beside the mean."""
    measured, predicted = pressed_and_slid()
    noisy = measured + 4.0 * np.random.default_rng(1).standard_normal(measured.shape)
    stuck = noisy.copy()
    for row in range(1, ROWS):
        if SEGMENT[row] == SEGMENT[row - 1]:
            stuck[row] = np.clip(stuck[row - 1], noisy[row] - play, noisy[row] + play)
    assert found(np.rint(stuck), predicted) == []


def test_nothing_is_found_in_nothing() -> None:
    few = np.full((3, len(CHANNELS)), 2500.0)
    assert loose_contacts(few, few, np.zeros(3, np.int64)) == []


@pytest.mark.parametrize("step", [4.0, 8.0, 16.0])
def test_the_steps_of_a_coarse_converter_are_no_absences(step: float) -> None:
    measured, predicted = pressed_and_slid()
    assert found(step * np.rint(measured / step), predicted) == []

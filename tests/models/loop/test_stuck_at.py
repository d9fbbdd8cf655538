"""Which channels count as broken: those that stand still where they ought to move."""

from collections.abc import Callable
from typing import Final

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel_models.loop.basis import Floats
from taxel_models.loop.stuck_at import StuckChannel, stuck_channels

ROWS: Final = 7_000
E5: Final = CHANNELS.index("e5")
SEGMENT: Final = np.repeat(np.arange(10), ROWS // 10)

Pair = tuple[Floats, Floats]


def tared(noise: float = 0.5) -> Pair:
    """Measured and predicted magnitudes, whole counts: at rest, pressed and slid about, at rest."""
    random = np.random.default_rng(4)
    phase = np.tile(np.linspace(0.0, 1.0, ROWS // 10), 10)
    pressed = np.clip(4.0 * np.minimum(phase, 1.0 - phase) - 0.4, 0.0, 1.0)
    slides = 1.0 + 0.4 * np.sin(2.0 * np.pi * np.arange(ROWS) / 60.0)
    predicted = (pressed * slides)[:, None] * np.linspace(6.0, 40.0, len(CHANNELS))
    moving = noise * (predicted > 0) * random.normal(size=predicted.shape)
    return np.maximum(np.rint(predicted + moving), 0.0), predicted


def found(pair: Pair) -> list[StuckChannel]:
    measured, predicted = pair
    return stuck_channels(measured, predicted, SEGMENT)


def test_channels_that_rest_at_zero_are_not_broken() -> None:
    measured, predicted = tared()
    assert (measured[:, E5] == 0.0).mean() > 0.15
    assert found((measured, predicted)) == []


@pytest.mark.parametrize("value", [0.0, 9.0])
def test_a_channel_that_never_moves_is_stuck(value: float) -> None:
    measured, predicted = tared()
    measured[:, E5] = value
    (broken,) = found((measured, predicted))
    assert (broken.channel, broken.value, broken.kind) == (E5, value, "stuck")
    assert broken.rows.all()


def test_a_channel_that_freezes_midway_is_stuck_from_there_on() -> None:
    measured, predicted = tared()
    since = 3_650
    measured[since:, E5] = measured[since, E5]
    (broken,) = found((measured, predicted))
    assert (broken.channel, broken.kind) == (E5, "stuck")
    assert broken.rows[since:].all()
    assert since - 10 < np.argmax(broken.rows) <= since


def test_drop_outs_are_found_to_the_row() -> None:
    measured, predicted = tared()
    rows = np.zeros(ROWS, bool)
    for start in (200, 2_300, 4_500, 5_150):
        rows[start : start + 250] = True
    measured[rows, E5] = 3.0
    (broken,) = found((measured, predicted))
    assert (broken.channel, broken.kind) == (E5, "intermittent")
    np.testing.assert_array_equal(broken.rows[rows], True)
    # It may have had the same value just before or after.
    assert (broken.rows & ~rows).sum() < 10


def test_a_channel_that_bends_into_a_few_counts_is_not_broken() -> None:
    """It keeps values for long while the prediction moves, but comes to them by steps of one count."""
    measured, predicted = tared()
    slow = 0.6 * np.sin(2.0 * np.pi * np.arange(ROWS) / 180.0)
    measured[:, E5] = np.rint(9.0 * np.tanh(predicted[:, E5] / 3.0) + slow).clip(0.0)
    assert found((measured, predicted)) == []


def cut_off(measured: Floats, level: float) -> Floats:
    return np.minimum(measured, level)


def shifted(measured: Floats, level: float) -> Floats:
    return np.maximum(measured - level, 0.0)


@pytest.mark.parametrize("change", [cut_off, shifted])
@pytest.mark.parametrize("level", [8.0, 12.0, 16.0])
def test_a_channel_at_the_end_of_its_range_is_not_broken(
    change: Callable[[Floats, float], Floats], level: float
) -> None:
    measured, predicted = tared()
    measured[:, E5] = change(measured[:, E5], level)
    assert found((measured, predicted)) == []


def test_a_level_inside_the_range_where_a_channel_saturates_is_not_broken() -> None:
    measured, predicted = tared()
    level = np.rint(0.7 * measured.max(axis=0))
    # A few rows get through, so that the level is not the greatest value.
    through = np.arange(ROWS) % 997 == 300
    measured = np.where(through[:, None], measured, np.minimum(measured, level))
    assert found((measured, predicted)) == []


def test_where_noise_never_rests_a_channel_that_does_is_broken() -> None:
    random = np.random.default_rng(6)
    predicted = np.tile(1000.0 + 50.0 * np.sin(np.arange(ROWS) / 90.0)[:, None], (1, len(CHANNELS)))
    measured = np.rint(predicted + 4.0 * random.normal(size=predicted.shape))
    assert found((measured, predicted)) == []
    # A little patience is due.
    measured[5_000:5_027, E5] = measured[5_000, E5]
    assert found((measured, predicted)) == []
    measured[5_000:5_027, E5] += np.arange(27)
    # At the value that it has, without a jump, while nothing else moves far.
    measured[2_000:2_070, E5] = np.rint(predicted[2_000, E5])
    (broken,) = found((measured, predicted))
    assert (broken.channel, broken.kind) == (E5, "intermittent")
    np.testing.assert_array_equal(np.flatnonzero(broken.rows), np.arange(2_000, 2_070))


def noisy() -> Pair:
    """Channels whose noise never lets a value last."""
    random = np.random.default_rng(6)
    predicted = np.tile(1000.0 + 50.0 * np.sin(np.arange(ROWS) / 90.0)[:, None], (1, len(CHANNELS)))
    return np.rint(predicted + 4.0 * random.normal(size=predicted.shape)), predicted


def test_a_channel_that_becomes_quiet_beside_noisy_ones_is_not_broken() -> None:
    """It creeps from one value to the next by single counts."""
    measured, predicted = noisy()
    # A whole wave of what is predicted, so that it returns to where it left off.
    measured[2_150:2_715, E5] = np.rint(predicted[2_150, E5]) + np.arange(565) // 80 - 3
    assert found((measured, predicted)) == []


def test_the_end_of_its_range_that_a_fast_press_reaches_is_not_broken() -> None:
    measured, predicted = noisy()
    top = measured[:, E5].max() + 40.0
    measured[2_300:2_400, E5] = top
    # In by one large step, out by usual ones.
    measured[2_400:2_420, E5] = top - 3.0 * np.arange(1, 21)
    assert found((measured, predicted)) == []
    measured[2_400:2_420, E5] = predicted[2_400:2_420, E5]
    assert [broken.channel for broken in found((measured, predicted))] == [E5]


def test_a_channel_that_dies_at_the_end_of_its_range_is_stuck_from_there_on() -> None:
    measured, predicted = tared()
    since = 2_450
    measured[since:, E5] = 0.0
    (broken,) = found((measured, predicted))
    assert (broken.channel, broken.value, broken.kind) == (E5, 0.0, "stuck")
    assert broken.rows[since:].all()


def test_a_channel_that_comes_back_from_the_end_of_its_range_is_not_dead() -> None:
    measured, predicted = tared()
    measured[2_100:5_600, E5] = 0.0
    assert all(broken.kind != "stuck" for broken in found((measured, predicted)))

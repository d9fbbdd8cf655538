"""Channels whose wires are exchanged are told from other faults, and from channels that are alike."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel_models.loop.crossed_channels import crossed_channels, crossed_since
from taxel_models.loop.effects.effect import Remaining
from taxel_models.loop.effects.fault import Fault
from taxel_models.loop.observations import gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.recordings import Recording

Make = Callable[..., Recording]
OWN = np.arange(21)


def exchanged(*channels: int) -> np.ndarray:
    """Each of these channels holds the next one's signal, and the last one the first's."""
    holds = OWN.copy()
    holds[list(channels)] = np.roll(channels, -1)
    return holds


def signals(seed: int = 0, rows: int = 2_000) -> np.ndarray:
    """(n, 21) smooth signals of a few causes in common, as channels of one contact have."""
    random = np.random.default_rng(seed)
    causes = np.cumsum(random.normal(size=(rows, 6)), axis=0)
    return np.asarray(2000.0 + causes @ random.normal(size=(6, 21)) * 5.0)


def smoothed(noise: np.ndarray, rows: int = 50) -> np.ndarray:
    """(n, c) slow noise of size 1."""
    slow = np.apply_along_axis(np.convolve, 0, noise, np.ones(rows) / rows, mode="same")
    return np.asarray(slow / slow.std(axis=0))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 999), channels=st.permutations(range(21)), count=st.integers(2, 6))
def test_each_exchange_is_found(seed: int, channels: list[int], count: int) -> None:
    holds = exchanged(*channels[:count])
    predicted = signals(seed)
    noise = np.random.default_rng(seed).normal(size=predicted.shape) * 2.0
    np.testing.assert_array_equal(crossed_channels(predicted[:, holds] + noise, predicted), holds)


def test_a_few_rows_that_jump_make_no_exchange() -> None:
    """They are nearly all of a channel's squares, in either order; its other rows show its own signal."""
    predicted = signals()
    measured = predicted + np.random.default_rng(1).normal(size=predicted.shape) * 2.0
    measured[:, 9] = predicted[:, 5]
    measured[100::250, 5] += 60.0 * predicted[:, 5].std()
    np.testing.assert_array_equal(crossed_channels(measured, predicted), OWN)
    measured[:, 5] = predicted[:, 9]
    measured[100::250, 5] += 60.0 * predicted[:, 5].std()
    np.testing.assert_array_equal(crossed_channels(measured, predicted), exchanged(5, 9))


def test_neighbours_of_one_shape_and_two_sizes_are_told_by_both() -> None:
    # Shapes differ by no more than what the model errs.
    predicted, random = signals(), np.random.default_rng(1)
    predicted[:, 9] = 2000.0 + 0.6 * (predicted[:, 5] - 2000.0)
    predicted[:, [5, 9]] += 0.1 * predicted[:, 5].std() * smoothed(random.normal(size=(2_000, 2)))
    error = 0.3 * predicted.std(axis=0) * smoothed(random.normal(size=predicted.shape))
    holds = exchanged(5, 9)
    np.testing.assert_array_equal(crossed_channels(predicted[:, holds] + error[:, holds], predicted), holds)
    np.testing.assert_array_equal(crossed_channels(predicted + error, predicted), OWN)


def test_two_exchanges_and_the_order_of_another_driver_are_found() -> None:
    predicted, holds = signals(), exchanged(3, 8)
    holds[[12, 17]] = 17, 12
    np.testing.assert_array_equal(crossed_channels(predicted[:, holds], predicted), holds)
    turned_round = np.concatenate([[0, 1], np.arange(20, 1, -1)])
    np.testing.assert_array_equal(crossed_channels(predicted[:, turned_round], predicted), turned_round)


@pytest.mark.parametrize("seed", range(5))
def test_offsets_gains_and_noise_cross_nothing(seed: int) -> None:
    predicted, random = signals(seed), np.random.default_rng(seed)
    size = predicted.std(axis=0)
    offset, gain = random.normal(size=21) * size, random.uniform(0.3, 3.0, 21)
    noise = random.normal(size=predicted.shape) * size
    for measured in (predicted + offset, predicted * gain, predicted + noise, np.zeros_like(predicted)):
        np.testing.assert_array_equal(crossed_channels(measured, predicted), OWN)


def test_channels_that_are_alike_or_constant_are_left_alone() -> None:
    predicted = signals()
    predicted[:, 5] = predicted[:, 9]
    predicted[:, 0] = 7.0
    measured = predicted[:, exchanged(5, 9)]
    np.testing.assert_array_equal(crossed_channels(measured, predicted), OWN)
    for rows in (0, 1, 2, 5):
        np.testing.assert_array_equal(crossed_channels(measured[:rows], predicted[:rows]), OWN)


def test_the_order_of_another_driver_is_weighed_beside_other_effects(smooth: Any, make: Make) -> None:
    recording = make(9_000, seed=3)
    order = np.concatenate([[0, 1], np.random.default_rng(4).permutation(np.arange(2, 21))])
    other = replace(recording, channels=recording.channels[:, order])
    (found,) = run_loop(smooth, [other], LoopSettings()).findings.effects
    assert found.name == "fault"
    assert found.form.count(" holds ") == (order != OWN).sum()


@pytest.mark.parametrize("begins", [300, 1_000, 1_300])
def test_the_moment_since_when_channels_are_crossed_is_found(begins: int) -> None:
    predicted, holds = signals(), exchanged(4, 11)
    measured = predicted + np.random.default_rng(1).normal(size=predicted.shape) + 20.0
    measured[begins:] = measured[begins:, holds]
    found, since = crossed_since(measured, predicted)
    np.testing.assert_array_equal(found, holds)
    assert abs(since - begins) <= 20
    whole, start = crossed_since(predicted[:, holds], predicted)
    np.testing.assert_array_equal(whole, holds)
    assert start == 0
    # What is unclear at the start does not hide what is clear over all of it.
    doubtful = predicted[:, holds].copy()
    doubtful[:300] = 0.55 * predicted[:300] + 0.45 * predicted[:300, holds]
    found, since = crossed_since(doubtful, predicted)
    np.testing.assert_array_equal(found, holds)
    assert since == 0
    for rows in (0, 1, 2_000):
        np.testing.assert_array_equal(crossed_since(predicted[:rows], predicted[:rows])[0], OWN)


def test_a_channel_that_holds_another_one_is_not_said_to_have_lost_sensitivity(
    smooth: Any, make: Make
) -> None:
    recording = make(9_000, seed=3)
    counts = recording.channels.copy()
    counts[5_000:] = counts[5_000:, exchanged(4, 11)]
    result = run_loop(smooth, [replace(recording, channels=counts)], LoopSettings())
    (found,) = result.findings.effects
    assert found.form.startswith("crossed: e3 holds e10, e10 holds e3, from ")
    assert int(found.form.split()[-3]) == pytest.approx(50, abs=1)
    assert found.channels == ("e3", "e10")
    assert result.changes == ()


def test_few_contacts_tell_no_exchange_in_the_course(smooth: Any, make: Make) -> None:
    """A weak model errs in them by as much as channels differ."""
    recording = make(2_500, seed=3)
    observations = gather(smooth, [recording])
    late = int(np.searchsorted(observations.contact, np.unique(observations.contact)[-5]))
    counts = recording.channels.copy()
    counts[late:] = counts[late:, exchanged(4, 11)]
    few = gather(smooth, [replace(recording, channels=counts)])
    assert crossed_since(few.measured, few.predicted)[1] > 0
    every = np.ones(len(few), np.bool_)
    assert list(Fault().forms(few, Remaining(few.residual, every, np.ones(len(few))))) == []


def test_channels_of_one_recording_may_be_crossed_in_the_next_one(smooth: Any, make: Make) -> None:
    first, second = make(9_000, seed=3), make(6_000, seed=4)
    crossed = replace(second, channels=second.channels[:, exchanged(4, 11)])
    result = run_loop(smooth, [first, crossed], LoopSettings())
    (found,) = result.findings.effects
    assert found.form.startswith("crossed: e3 holds e10, e10 holds e3, from ")
    assert not result.findings.unexplained.structured


def test_the_loop_names_the_channels_and_changes_no_model(smooth: Any, make: Make) -> None:
    recording = make(9_000, seed=3)
    crossed = replace(recording, channels=recording.channels[:, exchanged(4, 11)])
    result = run_loop(smooth, [crossed], LoopSettings())
    (found,) = result.findings.effects
    assert (found.name, found.form) == ("fault", "crossed: e3 holds e10, e10 holds e3")
    assert found.channels == ("e3", "e10")
    assert (found.served, result.new.effects) == (False, ())
    # What is left is the noise of all channels.
    assert not result.findings.unexplained.structured

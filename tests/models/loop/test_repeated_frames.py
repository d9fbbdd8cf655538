"""Frames that are repeated are told from a slow sensor, from rest, and from a finger that is held still."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.pipeline import LoopSettings, run_loop
from taxel_models.loop.repeated_frames import held, repeated_frames
from taxel_models.recordings import Recording

Make = Callable[..., Recording]


def observed(model: Any, recording: Recording) -> Observations:
    return gather(model, [recording])


def lost(rows: int, share: float, length: int, seed: int = 0) -> NDArray[np.bool_]:
    """Which rows are lost: the same share of whole frames of so many rows."""
    random = np.random.default_rng(seed)
    rows_lost = np.repeat(random.random(rows // length + 1) < share, length)[:rows]
    rows_lost[0] = False
    return rows_lost


def dropped(recording: Recording, rows: NDArray[np.bool_]) -> Recording:
    ticks = recording.ticks()
    return replace(ticks, channels=held(ticks.channels, rows))


@pytest.mark.parametrize(("share", "length"), [(0.05, 3), (0.3, 2), (0.6, 8), (0.2, 1)])
def test_frames_that_were_lost_are_found(smooth: Any, make: Make, share: float, length: int) -> None:
    recording = make(seed=3)
    rows = lost(len(recording.ticks()), share, length)
    observations = observed(smooth, dropped(recording, rows))
    found = repeated_frames(observations)
    expected = rows[observations.rows[0]]
    # Single rows are counted once longer stretches show that frames are lost.
    assert (found == expected).mean() > 0.99
    assert found.mean() == pytest.approx(expected.mean(), rel=0.1)


def test_a_sensor_that_is_read_too_often_repeats_single_rows(smooth: Any, make: Make) -> None:
    recording = make(seed=3)
    rows = np.arange(len(recording.ticks())) % 7 == 3
    assert not repeated_frames(observed(smooth, dropped(recording, rows))).any()


def test_a_recording_without_any_repeated_row_has_none(smooth: Any, make: Make) -> None:
    assert not repeated_frames(observed(smooth, make(seed=3))).any()


def test_a_finger_that_is_held_still_without_noise_is_not_it(smooth: Any, make: Make) -> None:
    """Counts of a simulation stand still with the force, and all change when it goes on."""
    ticks = make(seed=3).ticks()
    still = lost(len(ticks), 0.5, 40)
    position, force = held(ticks.samples.position, still), held(ticks.samples.force, still)
    counts = np.clip(np.rint(smooth.counts(position, force)), 0, 4095)
    samples = replace(ticks.samples, position=position, force=force)
    assert not repeated_frames(observed(smooth, replace(ticks, samples=samples, channels=counts))).any()


def test_tared_electrodes_at_rest_are_not_it(smooth: Any, make: Make) -> None:
    """A finger that moves through the air: electrodes rest at 0, and leave it one after another."""
    observations = observed(smooth, make(seed=3))
    load = np.clip(np.sin(np.arange(len(observations)) / 60.0), 0.0, 1.0)
    measured = np.rint(np.maximum(load[:, None] * np.linspace(20.0, 40.0, 21) - np.arange(21.0), 0.0))
    assert not repeated_frames(replace(observations, measured=measured)).any()


def test_a_hum_that_is_cut_off_at_rest_is_not_it(smooth: Any, make: Make) -> None:
    """All electrodes leave 0 together with each wave, and come back to it."""
    observations = observed(smooth, make(seed=3))
    wave = 8.0 * np.sin(2.0 * np.pi * 17.3 * np.arange(len(observations)) / 100.0)
    measured = np.rint(np.maximum(wave[:, None] * np.linspace(0.5, 1.0, 21), 0.0))
    assert not repeated_frames(replace(observations, measured=measured)).any()


def test_a_segment_may_begin_and_end_with_a_repeated_frame(smooth: Any, make: Make) -> None:
    ticks = make(seed=3).ticks()
    parts = ticks.rows(np.arange(len(ticks)) % 700 >= 20)
    rows = np.zeros(len(parts), bool)
    for part in parts.segments:
        rows[part.start + 1 : part.start + 60] = True
        rows[part.stop - 30 : part.stop] = True
    observations = observed(smooth, dropped(parts, rows))
    # The first window of a segment has no row before it to compare with.
    expected = rows[observations.rows[0]] & (np.diff(observations.segment, prepend=-1) == 0)
    np.testing.assert_array_equal(repeated_frames(observations), expected)


def test_the_loop_names_it_and_says_how_many(smooth: Any, make: Make) -> None:
    recording = make(12_000, seed=3)
    rows = lost(len(recording.ticks()), 0.4, 6)
    result = run_loop(smooth, [dropped(recording, rows)], LoopSettings())
    (effect,) = result.findings.effects
    assert (effect.name, effect.form, effect.served) == ("fault", "repeated frames", False)
    (share,) = effect.parameters
    assert share.value == pytest.approx(rows.mean(), rel=0.05)
    assert effect.explained > 0.2


def test_held_repeats_the_last_row_that_was_read() -> None:
    values = np.arange(6.0)[:, None]
    repeated = np.array([False, True, False, True, True, False])
    np.testing.assert_array_equal(held(values, repeated)[:, 0], [0, 0, 2, 2, 2, 5])

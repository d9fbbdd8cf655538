"""Predictions, measurements, and what else is known of each row, aligned."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel.corrections import AppliedEffect, Correction, Frame, Weighted
from taxel.errors import RecordingError
from taxel.windows import Relaxation, history_columns
from taxel_models.loop.observations import Observations, gather, runs
from taxel_models.loop.resting import are_raw, resting
from taxel_models.model import predict_all
from taxel_models.recordings import Recording


def test_runs_are_of_equal_numbers_that_follow_each_other() -> None:
    assert runs(np.array([0, 0, 2, 2, 2, 0])) == [slice(0, 2), slice(2, 5), slice(5, 6)]


def test_rows_are_aligned(observations: Observations, recording: Recording, smooth: Any) -> None:
    (rows,) = observations.rows
    np.testing.assert_array_equal(rows, np.arange(10, len(recording) - 10))
    np.testing.assert_array_equal(observations.measured, recording.channels[rows])
    expected = smooth.counts(recording.samples.position[rows], recording.samples.force[rows])
    np.testing.assert_allclose(observations.predicted, expected, atol=0.01)
    np.testing.assert_array_equal(observations.base, observations.predicted)
    np.testing.assert_allclose(observations.time_s, rows / 100)
    np.testing.assert_array_equal(
        observations.covariates["material"], recording.covariates["material"][rows]
    )
    np.testing.assert_array_equal(observations.covariates["tdc"], recording.auxiliary["tdc"][rows])
    assert "pac1" not in observations.covariates


def test_an_unmeasured_temperature_is_no_covariate(recording: Recording, smooth: Any) -> None:
    observations = gather(smooth, [recording], withheld=("tdc", "tac"))
    assert set(observations.covariates) == {"material"}


def test_segments_are_numbered_through_and_only_common_columns_count(
    make: Callable[..., Recording], smooth: Any
) -> None:
    first, second = make(600), replace(make(500, seed=4), covariates={})
    gap = first.rows(np.arange(600) // 100 != 2)
    observations = gather(smooth, [gap, second])
    assert set(observations.covariates) == {"tac", "tdc"}
    assert list(np.unique(observations.segment)) == [0, 1, 2]
    assert [len(rows) for rows in observations.rows] == [180 + 280, 480]
    np.testing.assert_allclose(observations.time_s[observations.segment == 2][0], 0.1)
    np.testing.assert_allclose(observations.time_s[observations.segment == 1][0], 3.1)


def test_recordings_without_a_whole_window_are_refused(make: Callable[..., Recording], smooth: Any) -> None:
    with pytest.raises(RecordingError, match="no whole window"):
        gather(smooth, [make(15)])


def test_rest_is_that_of_free_air(observations: Observations) -> None:
    np.testing.assert_allclose(observations.rest[:2], [2040.0, 1500.0], atol=2.0)
    assert observations.raw_counts
    tared = replace(observations, base=observations.base - observations.rest)
    assert not tared.raw_counts
    pressed = observations.kept(observations.pressed > 0.5)
    least = pressed.pressed <= np.quantile(pressed.pressed, 0.02)
    np.testing.assert_allclose(pressed.rest, np.median(pressed.base[least], axis=0))


def test_some_rows_keep_their_past(observations: Observations, recording: Recording) -> None:
    feature = Relaxation(of="force", time_constant_s=1.0)
    expected = history_columns(recording.samples, [feature])[observations.rows[0], 0]
    np.testing.assert_array_equal(observations.history(feature), expected)
    keep = observations.time_s > 30.0
    some = observations.kept(keep)
    np.testing.assert_array_equal(some.history(feature), expected[keep])
    np.testing.assert_array_equal(some.measured, observations.measured[keep])


def test_the_usual_travel_of_the_force_is_that_of_a_segment(observations: Observations) -> None:
    force = observations.pressed
    assert observations.usual_travel_n == pytest.approx(force.max() - force.min())
    thirds = 3 * np.arange(len(force)) // len(force)
    travels = [np.ptp(force[thirds == third]) for third in range(3)]
    assert replace(observations, segment=thirds).usual_travel_n == pytest.approx(np.median(travels))


def test_earlier_rows_are_of_the_same_segment(observations: Observations) -> None:
    parts = replace(observations, segment=(np.arange(len(observations)) >= 1000).astype(np.int64))
    rows = np.arange(len(observations))
    earlier, later = parts.rows_before(3), parts.rows_before(-3)
    whole = (rows >= 3) & ~((rows >= 1000) & (rows < 1003))
    np.testing.assert_array_equal(earlier[whole], rows[whole] - 3)
    np.testing.assert_array_equal(earlier[~whole], rows[~whole])
    np.testing.assert_array_equal(later[997:1001], [997, 998, 999, 1003])
    np.testing.assert_array_equal(later[-3:], rows[-3:])
    holes = observations.kept(rows % 5 != 0)
    there = holes.rows_before(2)
    apart = holes.time_s - holes.time_s[there]
    assert set(np.round(apart, 3)) == {0.0, 0.02}


def test_a_calibration_is_of_each_segments_first_seconds(observations: Observations) -> None:
    segment = np.arange(len(observations)) // 2000
    offsets = np.random.default_rng(0).normal(size=(5, 21)) * 10
    shifted = replace(observations, segment=segment, measured=observations.predicted + offsets[segment])
    found = shifted.calibrated(0.5)
    assert len(found) == len(observations) - 5 * 50
    assert found.calibration is not None
    np.testing.assert_allclose(found.calibration.offsets, offsets[found.segment], atol=1e-9)
    began = observations.time_s[segment * 2000] + 0.5
    kept = np.isin(observations.time_s, found.time_s)
    np.testing.assert_allclose(found.calibration.age_s, (observations.time_s - began)[kept], atol=1e-6)
    with pytest.raises(RecordingError, match="no segment is longer than the 30 s"):
        shifted.calibrated(30.0)


def test_requests_are_of_a_size_that_servers_take(observations: Observations, smooth: Any) -> None:
    sizes = []

    def predict(windows: np.ndarray) -> np.ndarray:
        sizes.append(len(windows))
        return smooth.predict(windows)

    found = predict_all(predict, observations.windows)
    assert max(sizes) <= 4096
    assert sum(sizes) == len(observations)
    np.testing.assert_array_equal(found, observations.predicted)


def test_a_corrected_model_is_asked_for_its_base(smooth: Any, recording: Recording) -> None:
    term = Weighted(shape="unit", features=("one",), references=(0.0,), weights=((12.0,) * 21,))
    effect = AppliedEffect(name="offset", about="Twelve.", channels=CHANNELS, terms=(term,))

    class Corrected:
        manifest = smooth.manifest.model_copy(update={"effects": (effect,)})
        predict_base = staticmethod(smooth.predict)

        def predict(self, windows: np.ndarray) -> np.ndarray:
            return Correction((effect,), self.manifest.spec, ()).apply(smooth.predict, windows)

    found = gather(Corrected(), [recording])
    np.testing.assert_array_equal(found.base, predict_all(smooth.predict, found.windows))
    np.testing.assert_allclose(found.predicted, found.base + 12.0, atol=1e-3)
    again = found.with_windows(found.windows[::-1], shift_ticks=0)
    np.testing.assert_allclose(again.predicted, again.base + 12.0, atol=1e-3)


def test_windows_may_be_turned_and_predicted_anew(observations: Observations) -> None:
    still = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    turn = Frame(
        position_rotation=still,
        position_translation=(0.0, 0.0, 0.0),
        force_rotation=((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    )
    turned = turn.turn(observations.windows, observations.manifest.spec)
    found = observations.with_windows(turned, shift_ticks=2)
    assert found.shift_ticks == 2
    assert np.abs(found.predicted - observations.predicted).max() > 20
    back = found.with_windows(observations.windows, shift_ticks=0)
    np.testing.assert_array_equal(back.predicted, observations.predicted)


def test_rest_is_free_air_or_where_it_is_pressed_least_or_0_for_tared_channels() -> None:
    random = np.random.default_rng(0)
    pressed = random.uniform(3.0, 15.0, 5_000)
    raw = 2_800.0 - 30.0 * pressed[:, None] + random.normal(size=(5_000, 21))
    tared = 2.0 * pressed[:, None] + random.normal(size=(5_000, 21))
    np.testing.assert_allclose(resting(pressed, raw), 2_800.0 - 30.0 * 3.1, atol=5.0)
    np.testing.assert_array_equal(resting(pressed, tared), 0.0)
    assert are_raw(resting(pressed, raw))
    assert not are_raw(resting(pressed, tared))
    # Some free air tells it for either, and what the channels drifted to since they were tared.
    free = pressed.copy()
    free[:200] = 0.0
    for counts in (raw, tared):
        counts[:200] += 1.0
        np.testing.assert_array_equal(resting(free, counts), np.median(counts[:200], axis=0))

"""Inputs that look wrong are told by name; right ones are not."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import taxel
from taxel.errors import InputWarning, InvalidArgument
from taxel.input_checks import (
    FORCE_UNITS,
    InputCheck,
    contact_findings,
    extra_findings,
    interval_findings,
    rate_findings,
)
from taxel.trained_contacts import TrainedContacts, outward
from taxel_models.twin import simulate

TRAINING = simulate(30_000, 1)
TRAINED = TrainedContacts.of(
    TRAINING.samples.position, TRAINING.samples.force, {"tdc": TRAINING.auxiliary["tdc"]}, 10.0
)
STRETCHES = st.tuples(st.integers(2, 6), st.integers(0, 5))
"""Other twins' seeds, and which 2000 of their rows."""

RECORDED = {seed: simulate(12_000, seed).samples for seed in range(2, 7)}


def stretch(seed: int, part: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows = slice(2000 * part, 2000 * (part + 1))
    return RECORDED[seed].position[rows], RECORDED[seed].force[rows]


def names(position: NDArray[np.float64], force: NDArray[np.float64]) -> list[str]:
    return [finding.name for finding in contact_findings(TRAINED, position, force)]


def test_a_training_is_described_by_its_touches() -> None:
    assert TRAINED.on_skin == 1.0
    assert TRAINED.pressing > 0.99
    assert 0.005 < TRAINED.x.high < 0.01
    assert TRAINED.force.high == np.linalg.norm(TRAINING.samples.force, axis=1).max()
    assert TRAINED.extras["tdc"].low < TRAINED.extras["tdc"].high


@given(STRETCHES)
@settings(max_examples=20, deadline=None)
def test_right_samples_are_not_told(place: tuple[int, int]) -> None:
    assert names(*stretch(*place)) == []


@given(STRETCHES)
@settings(max_examples=20, deadline=None)
def test_millimetres_are_told(place: tuple[int, int]) -> None:
    position, force = stretch(*place)
    assert names(position * 1e3, force) == ["millimetres"]


@given(STRETCHES, st.sampled_from(sorted(FORCE_UNITS)))
@settings(max_examples=20, deadline=None)
def test_other_units_of_force_are_told(place: tuple[int, int], unit: str) -> None:
    position, force = stretch(*place)
    # What is far above any newtons is told; a press of 5 N is.
    force = force / np.linalg.norm(force, axis=1).max() * 5.0
    assert names(position, force / FORCE_UNITS[unit])[:1] == [unit]


@given(STRETCHES)
@settings(max_examples=20, deadline=None)
def test_the_wrong_sign_is_told(place: tuple[int, int]) -> None:
    position, force = stretch(*place)
    found = names(position, -force)
    assert "wrong sign" in found
    assert set(found) <= {"wrong sign", "fx out of range", "fy out of range", "fz out of range"}


@given(STRETCHES, st.sampled_from([0.02, -0.02, 0.3]))
@settings(max_examples=20, deadline=None)
def test_another_frame_is_told(place: tuple[int, int], shift: float) -> None:
    position, force = stretch(*place)
    assert names(position + np.array([0.0, shift, 0.0]), force) == ["off the skin"]


def test_the_text_says_what_was_seen_and_expected() -> None:
    (finding,) = contact_findings(TRAINED, np.array([[0.0, 0.0, -7.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert finding.text == "1 of 1 touched places look like millimetres, as 7: expected metres"
    (finding,) = contact_findings(TRAINED, np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
    assert "7 mm inside it: expected places on taxel.skin" in finding.text


def test_a_place_on_the_nail_is_out_of_range() -> None:
    assert names(np.array([[-0.005, 0.0, 0.007]]), np.array([[0.0, 0.0, -1.0]])) == ["z out of range"]


def test_a_model_of_another_frame_knows_no_skin() -> None:
    position, force = stretch(2, 0)
    moved = position + np.array([0.5, 0.0, 0.3])
    trained = TrainedContacts.of(moved, force, {}, 10.0)
    assert trained.on_skin < 0.9
    assert contact_findings(trained, moved, force) == []
    found = contact_findings(trained, moved * 1e3, force)
    assert [finding.name for finding in found] == ["millimetres"]


def test_a_training_whose_forces_pull_expects_that() -> None:
    position, force = stretch(2, 0)
    trained = TrainedContacts.of(position, -force, {}, 10.0)
    assert contact_findings(trained, position, -force) == []
    assert "wrong sign" in [finding.name for finding in contact_findings(trained, position, force)]


def test_presses_point_against_the_normal() -> None:
    places = np.array([[0.0, 0.0, -0.007], [0.007, 0.0, 0.0]])
    assert outward(places, np.array([[0.0, 0.0, 1.0], [-2.0, 0.0, 0.0]])).tolist() == [-1.0, -2.0]


def test_rates_and_extras_are_compared_too() -> None:
    assert rate_findings(TRAINED, 1 / 60) == []
    assert [finding.name for finding in rate_findings(TRAINED, 1 / 30)] == ["rate"]
    assert interval_findings(0.01, 0.01, ticks=True) == []
    assert interval_findings(0.002, 0.001, ticks=False) == []
    assert "give rate_hz=500" in interval_findings(0.002, 0.01, ticks=True)[0].text
    assert "looks like milliseconds" in interval_findings(2.0, 0.002, ticks=False)[0].text
    assert extra_findings(TRAINED, "tdc", np.array([TRAINED.extras["tdc"].high])) == []
    assert extra_findings(TRAINED, "tdc", np.array([30.0]))[0].name == "tdc out of range"
    assert extra_findings(TRAINED, "unheard", np.array([30.0])) == []


@given(st.integers(1, 5000), st.integers(1, 40))
@settings(max_examples=20, deadline=None)
def test_a_check_warns_once_however_samples_come(count: int, steps: int) -> None:
    check = InputCheck("m/1", TRAINED, 0.01, ticks=True, strict=False)
    position = np.tile([0.0, 0.0, -7.0], (count, 1))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for _ in range(steps):
            check.take(position, np.tile([0.0, 0.0, 1.0], (count, 1)))
    assert [(warning.category, str(warning.message)[:5]) for warning in told] == [(InputWarning, "m/1: ")]


def test_what_looks_wrong_stands_until_later_touches_look_right() -> None:
    place, press = np.array([[0.0, 0.0, -0.007]]), np.array([[0.0, 0.0, 1.0]])
    with pytest.warns(InputWarning, match="a sample every 50 ms"):
        check = InputCheck("m/1", TRAINED, 0.05, ticks=True, strict=False)

    def take(force: NDArray[np.float64], steps: int) -> list[str]:
        for _ in range(steps):
            check.take(place, force)
        return check.standing

    rate = "m/1: a sample every 50 ms: expected one every 10 ms or so"
    assert take(press, 200) == [rate]
    grams = "m/1: forces up to 102 look like grams: expected newtons, up to 8.81"
    with pytest.warns(InputWarning, match="grams"):
        assert take(press * 101.97, 200) == [rate, grams]
    # Where nothing touches, nothing can be told.
    assert take(0.0 * press, 500) == [rate, grams]
    assert take(press, 200) == [rate]


@pytest.mark.parametrize("before", [0, 20, 300])
def test_a_strict_check_looks_at_each_sample_and_goes_on_where_they_are_right(before: int) -> None:
    check = InputCheck("m/1", TRAINED, 0.01, ticks=True, strict=True)
    place, press = np.array([[0.0, 0.0, -0.007]]), np.array([[0.0, 0.0, 1.0]])
    for _ in range(before):
        check.take(place, press)
    for _ in range(3):
        with pytest.raises(InvalidArgument, match=r"1 of .* touched places look like millimetres"):
            check.take(1e3 * place, press)
        check.take(place, press)
    # A sign is judged of some 20 touches.
    pulls = 0
    with pytest.raises(InvalidArgument, match="pull at the skin"):
        while pulls < 200:
            pulls += 1
            check.take(place, -press)
    assert pulls > 10
    for _ in range(200):
        check.take(place, press)
    assert check.standing == []


def test_a_stream_of_one_fingertip_is_looked_at_within_100_steps() -> None:
    with taxel.load() as models:
        stream = models.predictor().stream()
    for step in range(1000):
        stream.push(0.01 * step, [0.0, 0.0, -0.007], [0.0, 0.0, 1.0])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for step in range(1000, 1101):
            place = [0.0, 0.0, -7.0 if step == 1000 else -0.007]
            stream.push(0.01 * step, place, [0.0, 0.0, 1.0])
    assert ["1 of 100 touched places look like millimetres" in str(one.message) for one in told] == [True]


def test_the_warning_names_the_line_of_the_user() -> None:
    with taxel.load() as models:
        fingers = models.predictor("xgb").fingers(1)
        with pytest.warns(InputWarning, match="xgb/1: 1 of 1 touched places look like millimetres") as told:
            fingers.step([[0.0, 0.0, -7.0]], [[0.0, 0.0, 1.0]])
    assert told[0].filename == __file__


def test_what_fingers_begin_with_is_looked_at() -> None:
    with taxel.load() as models:
        predictor = models.predictor()
        fingers = predictor.fingers(3)
        with pytest.warns(InputWarning, match="1 of 1 touched places look like millimetres"):
            fingers.prime([[0.0, 0.0, -7.0]], [[0.0, 0.0, 1.0]], [1])
        strict, expected = predictor.fingers(3, strict=True), predictor.fingers(3)
        with pytest.raises(InvalidArgument, match="look like millimetres"):
            strict.prime([[0.0, 0.0, -7.0]], [[0.0, 0.0, 1.0]], [1])
        strict.prime(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, np.int64))
        rest = np.tile([0.0, 0.0, -0.007], (3, 1)), np.zeros((3, 3))
        np.testing.assert_array_equal(strict.step(*rest), expected.step(*rest))


def test_strict_streams_and_fingers_take_nothing_that_looks_wrong() -> None:
    with taxel.load() as models:
        predictor = models.predictor("xgb")
        fingers = predictor.fingers(1, strict=True)
        before = fingers.channels
        with pytest.raises(InvalidArgument, match="up to 300 look like grams: expected newtons"):
            fingers.step([[0.0, 0.0, -0.007]], [[0.0, 0.0, 300.0]])
        assert fingers.channels is before
        stream = predictor.stream(strict=True)
        with pytest.raises(InvalidArgument, match="off the skin"):
            stream.push(0.0, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
        with pytest.raises(InvalidArgument, match="a sample every 50 ms"):
            predictor.stream(rate_hz=20.0, strict=True)

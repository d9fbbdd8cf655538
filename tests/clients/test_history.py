"""Features of the past against slow, obvious definitions, and a live stream against a whole recording."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from taxel.errors import InvalidArgument
from taxel.windows import (
    BoundedRate,
    Direction,
    Elapsed,
    ExtraFeature,
    Friction,
    HistoryFeature,
    Load,
    LoadAbove,
    Play,
    Rate,
    Relaxation,
    RelaxationShare,
    Samples,
    Speed,
    Warmth,
    WindowSpec,
    WindowStream,
    build_windows,
    extra_columns,
    history_columns,
)
from taxel.windows.history import Followed, Lagged, Recursive

FOLLOWED: tuple[Followed, ...] = ("fx", "fy", "fz", "force")
FEATURES: tuple[HistoryFeature, ...] = (
    *(Relaxation(of=of, time_constant_s=0.07) for of in FOLLOWED),
    Relaxation(of="force", time_constant_s=0.07, starts="rest"),
    Relaxation(of="force", time_constant_s=0.3, whole=True),
    Relaxation(of="fz", time_constant_s=0.3, starts="rest", whole=True),
    RelaxationShare(of="force", time_constant_s=3.0),
    RelaxationShare(of="fy", time_constant_s=0.2),
    Play(of="force", width_n=0.4),
    Play(of="fx", width_n=1.5),
    Friction(of="force", width_n=0.4),
    Friction(of="fy", width_n=3.0),
    Load(of="fz"),
    LoadAbove(of="force", above_n=0.8),
    LoadAbove(of="fx", above_n=0.3),
    Warmth(of="force", warming_s=0.3, cooling_s=2.0),
    Warmth(of="fz", warming_s=5.0, cooling_s=0.2),
    Warmth(of="force", warming_s=0.3, cooling_s=2.0, starts="rest"),
    Rate(of="fz"),
    BoundedRate(of="force", half_n_s=2.0),
    Direction(of="force"),
    Speed(),
    Elapsed(start_s=0.1, end_s=0.6),
)


def recording(seed: int, rows: int, rate_hz: float = 100.0) -> Samples:
    """Random contacts with jitter in time and a few gaps."""
    rng = np.random.default_rng(seed)
    intervals = np.round(rng.uniform(0.97, 1.03, rows) * 1e9 / rate_hz).astype(np.int64)
    intervals[rng.random(rows) < 0.03] += 200_000_000
    position = np.cumsum(rng.normal(size=(rows, 3)) * 1e-4, axis=0)
    return Samples.of(np.cumsum(intervals), position, rng.normal(size=(rows, 3)), rate_hz=rate_hz)


def obvious_memory(feature: Recursive, course: list[float]) -> float:
    """A feature with a state, from the course of u since the segment's start."""
    u = course[-1]
    if isinstance(feature, Friction):
        behind = 0.0
        for before, now in pairwise(course):
            behind = (behind - (now - before)) / (1 + abs(now - before) / feature.width_n)
        return behind
    if isinstance(feature, Warmth):
        warmth = float(course[0] > 0.1 and feature.starts == "settled")
        for now in course[1:]:
            goal, tau = (1.0, feature.warming_s) if now > 0.1 else (0.0, feature.cooling_s)
            warmth = goal + (warmth - goal) * math.exp(-0.01 / tau)
        return warmth
    y = course[0]
    if isinstance(feature, Play):
        for now in course[1:]:
            y = min(max(y, now - feature.width_n), now + feature.width_n)
        return y - u
    assert isinstance(feature, (Relaxation, RelaxationShare))
    y = 0.0 if isinstance(feature, Relaxation) and feature.starts == "rest" else y
    for now in course[1:]:
        y += (1 - math.exp(-0.01 / feature.time_constant_s)) * (now - y)
    if isinstance(feature, RelaxationShare):
        return (y - u) / (abs(u) + 0.5)
    return y if feature.whole else y - u


def obvious(feature: HistoryFeature, samples: Samples, t: int) -> float:
    """The definition at one tick, from the segment's start on."""
    (segment,) = [s for s in samples.segments if s.start <= t < s.stop]
    if isinstance(feature, Elapsed):
        seconds = (samples.time_ns[t] - samples.time_ns[0]) / 1e9
        return float(min(max(seconds, feature.start_s), feature.end_s) - feature.start_s)
    if isinstance(feature, Speed):
        before = max(t - 10, segment.start)
        return math.dist(samples.position[t], samples.position[before]) / 0.1

    def u(row: int) -> float:
        force = samples.force[row]
        return math.hypot(*force) if feature.of == "force" else force[FOLLOWED.index(feature.of)]

    if isinstance(feature, Load):
        return u(t)
    if isinstance(feature, LoadAbove):
        return max(u(t) - feature.above_n, 0.0)
    if isinstance(feature, Lagged):
        rate = (u(t) - u(max(t - 3, segment.start))) / 0.03
        if isinstance(feature, BoundedRate):
            return rate / (feature.half_n_s + abs(rate))
        return rate if isinstance(feature, Rate) else math.tanh(rate) * abs(u(t))
    return obvious_memory(feature, [u(row) for row in range(segment.start, t + 1)])


@given(st.integers(0, 2**32), st.integers(1, 60))
@settings(max_examples=15)
def test_columns_equal_the_obvious_definition(seed: int, rows: int) -> None:
    samples = recording(seed, rows)
    expected = [[obvious(feature, samples, t) for feature in FEATURES] for t in range(rows)]
    np.testing.assert_allclose(history_columns(samples, FEATURES), expected, rtol=0, atol=1e-11)


@given(
    st.integers(0, 2**32),
    st.sampled_from([40.0, 100.0, 250.0]),
    st.sampled_from([1, 3, 6, 8]),
    st.integers(1, 3),
    st.sampled_from([-4, 0, 3]),
)
@settings(max_examples=30)
def test_a_live_stream_gives_the_same_windows_with_their_extras(
    seed: int, rate_hz: float, combination: int, fingers: int, shift: int
) -> None:
    rows = int(rate_hz * 0.8)
    of_fingers = [recording(seed, rows, rate_hz)] + [recording(seed + 1, rows, rate_hz)] * (fingers - 1)
    time = of_fingers[0].time_ns
    tdc = np.random.default_rng(seed).normal(2000, 5, (rows, fingers))
    extras = (
        ExtraFeature(name="tdc", unit="counts", default=1900.0),
        *(ExtraFeature(name=str(feature), unit="", history=feature) for feature in FEATURES),
        ExtraFeature(name="material", unit="", default=0.25),
    )
    spec = WindowSpec.of(combination, shift)
    stream = WindowStream(spec, rate_hz=rate_hz, fingers=fingers, extras=extras)
    position = np.stack([samples.position for samples in of_fingers], axis=1)
    force = np.stack([samples.force for samples in of_fingers], axis=1)
    live = [
        window
        for row in range(rows)
        for window in stream.push_ns(int(time[row]), position[row], force[row], {"tdc": tdc[row]})
    ]
    for finger, contact in enumerate(of_fingers):
        samples = Samples.of(time, contact.position, contact.force, rate_hz=rate_hz)
        windows = build_windows(samples, spec, extras, {"tdc": tdc[:, finger], "pac1": tdc[:, 0]})
        assert samples.ticks().time_ns[windows.rows].tolist() == [window.time_ns for window in live]
        values = np.array([window.values[finger] for window in live]).reshape(windows.values.shape)
        np.testing.assert_array_equal(values, windows.values)


def test_a_stream_starts_settled_and_again_after_reset() -> None:
    extra = ExtraFeature(name="creep", unit="N", history=Relaxation(of="fz", time_constant_s=1.0))
    clock = ExtraFeature(name="warm", unit="s", history=Elapsed(start_s=0, end_s=9))
    stream = WindowStream(WindowSpec.of(3), extras=(extra, clock))
    stream.push(5.0, [0, 0, 0], [0, 0, 3])
    (window,) = stream.push(5.01, [0, 0, 0], [0, 0, 4])
    assert window.values[0, 6] < -0.9
    assert window.values[0, 7] == np.float32(0.01)
    stream.reset()
    (window,) = stream.push(1.0, [0, 0, 0], [0, 0, 7])
    assert window.values[0, 6:].tolist() == [0, 0]


def test_what_is_given_holds_until_it_is_given_anew() -> None:
    extras = (ExtraFeature(name="tdc", unit="counts", default=5.0),)
    stream = WindowStream(WindowSpec.of(3), fingers=2, extras=extras)
    contact = np.zeros((2, 3)), np.ones((2, 3))
    given_extras = [None, {"tdc": 7.0}, None, {"tdc": [8.0, 9.0]}, {}]
    windows = [stream.push(step / 100, *contact, extras)[0] for step, extras in enumerate(given_extras)]
    assert [w.values[:, 6].tolist() for w in windows] == [[5, 5], [7, 7], [7, 7], [8, 9], [8, 9]]
    stream.reset()
    assert stream.push(9.0, *contact)[0].values[:, 6].tolist() == [5, 5]


@pytest.mark.parametrize(
    ("extras", "message"),
    [
        ({"speed": 1.0}, "no extra feature 'speed' is given by the caller; there is: tdc"),
        ({"tcd": 1.0}, "no extra feature 'tcd'"),
        ({"tdc": [1.0, 2.0]}, "expected a number, or one for each of 1 fingertips"),
        ({"tdc": "warm"}, "expected a number"),
        ({"tdc": np.nan}, "expected finite"),
    ],
)
def test_a_wrong_extra_is_refused_and_leaves_the_stream_as_it_was(extras: object, message: str) -> None:
    known = (
        ExtraFeature(name="tdc", unit="counts", default=5.0),
        ExtraFeature(name="speed", unit="m/s", history=Speed()),
    )
    stream = WindowStream(WindowSpec.of(3), extras=known)
    with pytest.raises(InvalidArgument, match=message):
        stream.push(0.0, [0, 0, 0], [0, 0, 1], extras)  # type: ignore[arg-type]
    (window,) = stream.push(0.0, [0, 0, 0], [0, 0, 1])
    assert window.values[0].tolist() == [0, 0, 0, 0, 0, 1, 5, 0]


def test_given_columns_of_another_length_are_refused() -> None:
    samples = recording(0, 20)
    extra = ExtraFeature(name="tdc", unit="counts")
    with pytest.raises(InvalidArgument, match=r"tdc has shape \(3,\): expected \(20,\)"):
        extra_columns(samples, [extra], {"tdc": np.zeros(3)})


@pytest.mark.parametrize("rows", [0, 1])
def test_few_ticks_have_as_many_values(rows: int) -> None:
    for feature in FEATURES:
        found = feature.column(np.ones((rows, 7)))
        assert found.shape == (rows,)
        assert np.isfinite(found).all()


def test_no_samples_give_no_rows() -> None:
    empty = Samples.of([], np.empty((0, 3)), np.empty((0, 3)))
    assert history_columns(empty, FEATURES).shape == (0, len(FEATURES))


@pytest.mark.parametrize("feature", FEATURES, ids=str)
def test_features_survive_being_written(feature: HistoryFeature) -> None:
    extra = ExtraFeature(name="past", unit="", history=feature, taken_by="effects")
    assert ExtraFeature.model_validate_json(extra.model_dump_json()) == extra


@pytest.mark.parametrize(
    "fields",
    [
        {"kind": "elapsed", "start_s": 5, "end_s": 5},
        {"kind": "relaxation", "of": "force", "time_constant_s": 0},
        {"kind": "relaxation", "of": "pressure", "time_constant_s": 1},
        {"kind": "play", "of": "force", "width_n": -1},
        {"kind": "guess"},
    ],
)
def test_impossible_features_are_refused(fields: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        TypeAdapter(HistoryFeature).validate_python(fields)


def test_friction_is_that_of_dahls_model() -> None:
    """The exact solution over loading, and over unloading from where that ended, of small steps."""
    force = np.concatenate([np.linspace(0.0, 3.0, 3_001), np.linspace(3.0, 0.0, 3_001)[1:]])
    ticks = np.zeros((len(force), 7))
    ticks[:, 5] = force
    found, width = Friction(of="force", width_n=1.2).column(ticks), 1.2
    loading = -width * (1.0 - np.exp(-force[:3_001] / width))
    np.testing.assert_allclose(found[:3_001], loading, atol=2e-3)
    unloading = width + (loading[-1] - width) * np.exp(-(3.0 - force[3_000:]) / width)
    np.testing.assert_allclose(found[3_000:], unloading, atol=2e-3)

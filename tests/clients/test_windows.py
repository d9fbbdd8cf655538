"""The window builder against a slow, obvious definition of the paper's eight combinations."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel.errors import InvalidArgument
from taxel.windows import COMBINATIONS, PERIOD_NS, Samples, WindowSpec, WindowStream, build_windows

LENGTHS = {1: 12, 2: 9, 3: 6, 4: 18, 5: 66, 6: 36, 7: 18, 8: 72}
LOOK_AHEAD = {1: 10, 2: 0, 3: 0, 4: 10, 5: 10, 6: 0, 7: 10, 8: 10}
STEPS = {
    1: [0, -10, 10],
    2: [0, -10],
    3: [0],
    4: [0, -10, -5, 5, 10],
    5: list(range(-10, 11)),
    6: list(range(-10, 1)),
    7: [0, -10, 10],
    8: list(range(-10, 11)),
}


def obvious_window(samples: Samples, t: int, combination: int) -> list[float] | None:
    """The definition, one value at a time; None where a needed sample is not in T's segment."""
    (segment,) = [s for s in samples.segments if s.start <= t < s.stop]
    needed = STEPS[combination] + ([-10, 10] if combination in (7, 8) else [])
    if any(not segment.start <= t + step < segment.stop for step in needed):
        return None

    def neighbour(direction: int) -> list[float]:
        for step in range(1, 11):
            there = samples.position[t + direction * step]
            if any(abs(there[axis] - samples.position[t][axis]) > 1e-6 for axis in range(3)):
                return list(there)
        return list(samples.position[t + direction * 10])

    values = list(samples.position[t])
    if combination in (7, 8):
        values += neighbour(-1) + neighbour(+1)
    for step in STEPS[combination]:
        values += list(samples.force[t + step])
    return values


@st.composite
def tick_samples(draw: st.DrawFn) -> Samples:
    """Recordings of ticks with gaps, held positions and moves around the 1e-6 m threshold."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    rows = draw(st.integers(1, 90))
    intervals = rng.integers(9_700_000, 10_300_000, rows)
    intervals[rng.random(rows) < draw(st.sampled_from([0.0, 0.03]))] = 60_000_000
    hold = draw(st.integers(1, 25))
    size = draw(st.sampled_from([2e-7, 1e-6, 1e-2]))
    moves = rng.normal(size=(rows // hold + 1, 3)) * size
    position = np.repeat(np.cumsum(moves, axis=0), hold, axis=0)[:rows]
    return Samples.of(np.cumsum(intervals), position, rng.normal(size=(rows, 3)), rate_hz=100)


@given(tick_samples(), st.sampled_from(COMBINATIONS))
def test_batch_windows_equal_the_obvious_definition(samples: Samples, combination: int) -> None:
    windows = build_windows(samples, WindowSpec.of(combination))
    expected = {t: obvious_window(samples, t, combination) for t in range(len(samples))}
    complete = [t for t, window in expected.items() if window is not None]
    assert windows.rows.tolist() == complete
    assert windows.values.shape == (len(complete), LENGTHS[combination])
    for row, t in enumerate(complete):
        np.testing.assert_array_equal(windows.values[row], np.float32(expected[t]))


@given(
    st.integers(0, 2**32),
    st.sampled_from([30.0, 60.0, 100.0, 240.0, 1000.0]),
    st.sampled_from(COMBINATIONS),
    st.integers(1, 3),
)
@settings(max_examples=60)
def test_a_live_stream_gives_the_same_numbers_at_any_rate(
    seed: int, rate_hz: float, combination: int, fingers: int
) -> None:
    rng = np.random.default_rng(seed)
    rows = int(rate_hz * 0.5)
    time = np.cumsum(rng.normal(1e9 / rate_hz, 5e7 / rate_hz, rows)).astype(np.int64)
    time[rows // 2 :] += 400_000_000
    position = np.cumsum(rng.normal(size=(rows, fingers, 3)) * 1e-6, axis=0)
    force = rng.normal(size=(rows, fingers, 3))
    spec = WindowSpec.of(combination)
    stream = WindowStream(spec, rate_hz=rate_hz, fingers=fingers)
    live = [w for i in range(rows) for w in stream.push_ns(int(time[i]), position[i], force[i])]
    for finger in range(fingers):
        samples = Samples.of(time, position[:, finger], force[:, finger], rate_hz=rate_hz)
        windows = build_windows(samples, spec)
        assert samples.ticks().time_ns[windows.rows].tolist() == [window.time_ns for window in live]
        values = np.array([window.values[finger] for window in live]).reshape(len(live), spec.length)
        np.testing.assert_array_equal(values, windows.values)


@given(st.integers(0, 2**32), st.sampled_from([40.0, 333.0, 1000.0]))
def test_resampling_is_linear_interpolation(seed: int, rate_hz: float) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.normal(1e9 / rate_hz, 1e8 / rate_hz, 80)).astype(np.int64)
    samples = Samples.of(time, rng.normal(size=(80, 3)), rng.normal(size=(80, 3)), rate_hz=rate_hz)
    ticks = samples.ticks()
    assert ticks.time_ns.tolist() == list(range(time[0], time[-1] + 1, PERIOD_NS))
    for axis in range(3):
        offset = (ticks.time_ns - time[0]).astype(float)
        expected = np.interp(offset, (time - time[0]).astype(float), samples.force[:, axis])
        np.testing.assert_allclose(ticks.force[:, axis], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("combination", COMBINATIONS)
def test_a_spec_says_its_length_names_and_delay(combination: int) -> None:
    spec = WindowSpec.of(combination)
    assert len(spec.features) == len(set(spec.features)) == spec.length == LENGTHS[combination]
    assert spec.look_ahead == LOOK_AHEAD[combination]
    assert spec.delay_s == pytest.approx(LOOK_AHEAD[combination] * 0.01)


def test_feature_names_follow_the_columns() -> None:
    assert WindowSpec.of(1).features == (
        *("x", "y", "z", "fx", "fy", "fz"),
        *("fx[-10]", "fy[-10]", "fz[-10]", "fx[+10]", "fy[+10]", "fz[+10]"),
    )
    assert WindowSpec.of(7).features[3:9] == (
        "x[last]",
        "y[last]",
        "z[last]",
        "x[next]",
        "y[next]",
        "z[next]",
    )


@pytest.mark.parametrize("combination", [0, 9, -1])
def test_an_unknown_combination_is_refused(combination: int) -> None:
    with pytest.raises(InvalidArgument, match="1 to 8"):
        WindowSpec.of(combination)


def test_no_samples_give_no_windows() -> None:
    empty = Samples.of([], np.empty((0, 3)), np.empty((0, 3)))
    assert len(build_windows(empty, WindowSpec.of(8))) == 0
    assert empty.segments == ()


@pytest.mark.parametrize(
    ("time", "position", "force", "message"),
    [
        ([0, 1], [[0, 0, 0]], [[0, 0, 0]] * 2, r"position has shape \(1, 3\): expected \(2, 3\)"),
        ([0, 1], [[0, 0, 0]] * 2, [[0, 0, np.nan]] * 2, r"force\[0\].*expected finite"),
        ([5, 5], [[0, 0, 0]] * 2, [[0, 0, 0]] * 2, r"time_ns\[1\] is 5, not after 5"),
        ([[0, 1]], [[0, 0, 0]] * 2, [[0, 0, 0]] * 2, "expected one time a sample"),
    ],
)
def test_bad_samples_are_refused(time: object, position: object, force: object, message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        Samples.of(time, position, force)


class TestStreamRefuses:
    """Each refusal leaves the stream as it was."""

    def setup_method(self) -> None:
        self.stream = WindowStream(WindowSpec.of(3))
        self.stream.push(0.0, [0, 0, 0], [0, 0, 1])

    def still_works(self) -> bool:
        (window,) = self.stream.push(0.01, [1, 2, 3], [4, 5, 6])
        return window.values.tolist() == [[1, 2, 3, 4, 5, 6]]

    def test_not_a_number(self) -> None:
        with pytest.raises(InvalidArgument, match=r"force is .*nan.*finite"):
            self.stream.push(0.01, [0, 0, 0], [0, 0, np.nan])
        assert self.still_works()

    def test_a_wrong_shape(self) -> None:
        with pytest.raises(InvalidArgument, match=r"position is \(2,\): expected numbers of shape \(3,\)"):
            self.stream.push(0.01, [0, 0], [0, 0, 0])
        assert self.still_works()

    def test_as_many_numbers_in_another_order(self) -> None:
        stream = WindowStream(WindowSpec.of(3), fingers=4)
        for values in (np.zeros((3, 4)), np.zeros(12)):
            with pytest.raises(InvalidArgument, match=r"force is .*expected numbers of shape \(4, 3\)"):
                stream.push(0.0, np.zeros((4, 3)), values)

    def test_what_no_sensor_shows(self) -> None:
        with pytest.raises(InvalidArgument, match=r"force is .*1e\+300.*at most 1e\+06 in size"):
            self.stream.push(0.01, [0, 0, 0], [0, 0, 1e300])
        assert self.still_works()

    @pytest.mark.parametrize("time_s", [1.8e18, None, "soon", np.array([0.0, 1.0])])
    def test_a_time_that_is_none(self, time_s: Any) -> None:
        with pytest.raises(InvalidArgument, match="time_"):
            self.stream.push(time_s, [0, 0, 0], [0, 0, 0])
        assert self.still_works()

    def test_times_of_a_type_without_a_sign(self) -> None:
        with pytest.raises(InvalidArgument, match="is not after"):
            for time_ns in np.array([50, 30], np.uint64):
                self.stream.push_ns(time_ns, [0, 0, 0], [0, 0, 0])
        with pytest.raises(InvalidArgument, match="expected whole nanoseconds"):
            self.stream.push_ns(0.5, [0, 0, 0], [0, 0, 0])  # type: ignore[arg-type]

    def test_text(self) -> None:
        with pytest.raises(InvalidArgument, match="force is 'press'"):
            self.stream.push(0.01, [0, 0, 0], "press")
        assert self.still_works()

    def test_time_that_does_not_increase(self) -> None:
        with pytest.raises(InvalidArgument, match="0 ns is not after 0 ns"):
            self.stream.push(0.0, [0, 0, 0], [0, 0, 0])
        assert self.still_works()

    def test_an_endless_time(self) -> None:
        with pytest.raises(InvalidArgument, match="time_s is inf"):
            self.stream.push(float("inf"), [0, 0, 0], [0, 0, 0])
        assert self.still_works()

    def test_a_rate_that_was_not_announced(self) -> None:
        with pytest.raises(InvalidArgument, match=r"every 1 ms .* rate_hz=1000"):
            for step in range(1, 102):
                self.stream.push(step / 1000, [0, 0, 0], [0, 0, 0])

    @pytest.mark.parametrize(("told", "true"), [(100, 60), (100, 125), (100, 80), (1000, 10), (100, 10)])
    def test_a_rate_other_than_told_is_said(self, told: float, true: float) -> None:
        stream = WindowStream(WindowSpec.of(1), rate_hz=told)
        with pytest.raises(InvalidArgument, match=f"rate_hz={true}"):
            for step in range(101):
                stream.push(step / true, [0, 0, 0], [0, 0, 0])

    def test_a_change_of_rate_is_said_whenever_it_comes(self) -> None:
        stream = WindowStream(WindowSpec.of(1))
        for step in range(250):
            stream.push(step / 100, [0, 0, 0], [0, 0, 0])
        with pytest.raises(InvalidArgument, match="rate_hz=50"):
            for step in range(201):
                stream.push(3 + step / 50, [0, 0, 0], [0, 0, 0])

    def test_jitter_and_dropped_frames_are_no_other_rate(self) -> None:
        stream = WindowStream(WindowSpec.of(1))
        rng = np.random.default_rng(0)
        steps = [step for step in range(400) if rng.random() > 0.05]
        windows = [
            window
            for step in steps
            for window in stream.push(step / 100 + rng.uniform(-0.003, 0.003), [0, 0, 0], [0, 0, 0])
        ]
        assert len(windows) == len(steps) - 20

    def test_a_rate_that_is_none(self) -> None:
        with pytest.raises(InvalidArgument, match="rate_hz is 0"):
            WindowStream(WindowSpec.of(3), rate_hz=0)

    def test_no_fingers(self) -> None:
        with pytest.raises(InvalidArgument, match="fingers is 0"):
            WindowStream(WindowSpec.of(3), fingers=0)

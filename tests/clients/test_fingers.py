"""Many fingertips at once are as many streams, each alone."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import taxel
from taxel.errors import InvalidArgument
from taxel.fingers import Fingers
from taxel.local import shipped_repository
from taxel.windows import WindowSpec, WindowStream
from taxel.windows.extras import ExtraFeature
from taxel.windows.fingers import FingerWindows
from taxel.windows.history import (
    Direction,
    Elapsed,
    HistoryFeature,
    Play,
    Relaxation,
    RelaxationShare,
    Speed,
)

HISTORIES: list[HistoryFeature] = [
    Relaxation(of="fz", time_constant_s=0.3),
    RelaxationShare(of="force", time_constant_s=0.1),
    Play(of="fz", width_n=0.4),
    Direction(of="fx"),
    Speed(),
    Elapsed(start_s=0.05, end_s=0.4),
]
EXTRAS = [
    ExtraFeature(name="tdc", unit="counts", default=5.0),
    *(ExtraFeature(name=f"h{place}", unit="1", history=one) for place, one in enumerate(HISTORIES)),
]
FINGERS = 3


@settings(max_examples=25)
@given(
    combination=st.integers(1, 8),
    rate=st.sampled_from([100.0, 240.0, 60.0, 1000.0]),
    shift=st.integers(-3, 3),
    seed=st.integers(0, 2**31),
)
def test_fingers_are_separate_streams(combination: int, rate: float, shift: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    spec = WindowSpec.of(combination, shift)
    windows = FingerWindows(spec, FINGERS, rate_hz=rate, extras=EXTRAS)
    streams = [WindowStream(spec, rate_hz=rate, extras=EXTRAS) for _ in range(FINGERS)]
    times = np.zeros(FINGERS, np.int64)
    for _ in range(70):
        if random.random() < 0.04:
            one = int(random.integers(FINGERS))
            windows.reset(np.array([one]))
            streams[one].reset()
        # Now and then a gap; else an interval that jitters a little.
        dt = (1e9 / rate * random.uniform(0.98, 1.02, FINGERS)).astype(np.int64)
        dt[random.random(FINGERS) < 0.02] *= 40
        position, force = random.normal(size=(2, FINGERS, 3))
        given_now = {"tdc": random.normal(size=FINGERS)} if random.random() < 0.5 else {}
        times += dt
        ids, values = windows.step(position, force, dt, given_now)
        got = dict(zip(ids.tolist(), values, strict=True))
        for one, stream in enumerate(streams):
            own = {name: column[one] for name, column in given_now.items()}
            expected = stream.push_ns(int(times[one]), position[one], force[one], own)
            assert (one in got) == bool(expected)
            if expected:
                np.testing.assert_array_equal(got[one], expected[-1].values[0])


def test_a_primed_finger_has_been_touched_so_for_long() -> None:
    spec = WindowSpec.of(5)
    windows = FingerWindows(spec, 2, extras=EXTRAS)
    stream = WindowStream(spec, extras=EXTRAS)
    state = np.array([[0.001, 0.002, -0.006, 0.1, 0.2, 1.5]])
    for tick in range(-60, 1):
        stream.push_ns(10_000_000 * tick, state[0, :3], state[0, 3:])
    windows.prime(np.array([1]), state[:, :3], state[:, 3:])
    moved = state + 0.001
    dt = np.full(2, 10_000_000)
    ids, values = windows.step(np.tile(moved[:, :3], (2, 1)), np.tile(moved[:, 3:], (2, 1)), dt)
    expected = stream.push_ns(10_000_000, moved[0, :3], moved[0, 3:])[-1].values[0]
    assert ids.tolist() == [1]
    elapsed = spec.length + 1 + HISTORIES.index(HISTORIES[-1])
    np.testing.assert_array_equal(np.delete(values[0], elapsed), np.delete(expected, elapsed))
    assert values[0][elapsed] == 0.0


class Echo:
    """Gives each window's first column on every channel."""

    class manifest:  # noqa: N801
        class window:  # noqa: N801
            extras = ()

    window = WindowSpec.of(2)

    def predict(self, windows: NDArray[np.float32], *, timeout: float | None = None) -> NDArray[np.float32]:
        return np.tile(windows[:, :1], (1, 21))


def rest(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.tile([0.0, 0.0, -0.007], (count, 1)), np.zeros((count, 3))


def test_a_shipped_model_answers_from_the_first_step() -> None:
    with taxel.load(shipped_repository()) as source:
        predictor = source.predictor("xgb")
        fingers = predictor.fingers(4)
        position, force = rest(4)
        first = fingers.step(position, force)
        alone = predictor.predict(np.tile(np.r_[position[0], np.zeros(9)].astype(np.float32), (1, 1)))
    assert first.shape == (4, 21)
    np.testing.assert_array_equal(first, np.tile(alone, (4, 1)))


def test_a_reset_touches_no_other_finger() -> None:
    fingers: Any = Fingers(Echo(), 3, rate_hz=100, prime=None)  # type: ignore[arg-type]
    for step in range(15):
        position, force = rest(3)
        position[:, 0] = step
        fingers.step(position, force)
    before = fingers.channels
    fingers.reset([1])
    assert np.isnan(fingers.channels[1]).all()
    np.testing.assert_array_equal(fingers.channels[[0, 2]], before[[0, 2]])
    after = fingers.step(*rest(3))
    assert np.isnan(after[1]).all()
    assert np.isfinite(after[[0, 2]]).all()


@pytest.mark.parametrize("rate", [100.0, 500.0])
def test_a_caller_may_change_what_it_was_given(rate: float) -> None:
    fingers, others = (Fingers(Echo(), 2, rate_hz=rate) for _ in range(2))  # type: ignore[arg-type]
    position, force = rest(2)
    position[:, 0] = 0.25
    for _ in range(12):
        given = fingers.step(position, force)
        np.testing.assert_array_equal(given, others.step(position, force))
        given[:] = -1.0
    np.testing.assert_array_equal(fingers.channels, 0.25)


@pytest.mark.parametrize("count", [0, -1, 2.5, True, "3", None])
def test_a_number_of_fingertips_that_is_none_is_told(count: Any) -> None:
    with pytest.raises(InvalidArgument, match=r"count is .*: expected a whole number, at least 1"):
        Fingers(Echo(), count, rate_hz=100)  # type: ignore[arg-type]


def test_torch_tensors_are_taken() -> None:
    fingers = Fingers(Echo(), 2, rate_hz=100)  # type: ignore[arg-type]
    position = torch.tensor([[0.25, 0, -0.007], [0.5, 0, -0.007]])
    given = fingers.step(position, torch.zeros(2, 3))  # type: ignore[arg-type]
    channels = torch.from_dlpack(given)
    assert channels[:, 0].tolist() == [0.25, 0.5]
    assert channels.data_ptr() == given.ctypes.data


def test_tensors_are_not_copied(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tensor of float64, which windows are built in, is read where it lies."""
    fingers = Fingers(Echo(), 2, rate_hz=100)  # type: ignore[arg-type]
    position, force = torch.rand(2, 3, dtype=torch.float64), torch.rand(2, 3, dtype=torch.float64)
    read = []

    def step(self: FingerWindows, place: Any, push: Any, *others: Any) -> Any:
        read.extend([place.ctypes.data, push.ctypes.data])
        return original(self, place, push, *others)

    original = FingerWindows.step
    monkeypatch.setattr(FingerWindows, "step", step)
    fingers.step(position, force)  # type: ignore[arg-type]
    assert read == [position.data_ptr(), force.data_ptr()]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"position": np.zeros((2, 3))}, r"position has shape \(2, 3\): expected \(3, 3\)"),
        ({"force": np.full((3, 3), np.nan)}, r"force\[0\] is \[nan, nan, nan\]: expected finite"),
        ({"force": np.full((3, 3), 1e300)}, r"force\[0\] is \[1e\+300, .*: expected finite"),
        ({"dt": 0.0}, "dt is 0.0: expected more than 0 s"),
        ({"dt": "soon"}, "dt: could not convert string"),
        ({"extras": {"heat": 1.0}}, "no extra feature 'heat'"),
        ({"position": torch.zeros(3, 3, requires_grad=True)}, "position: .*grad"),
    ],
)
def test_a_wrong_argument_changes_nothing(wrong: dict[str, Any], said: str) -> None:
    fingers = Fingers(Echo(), 3, rate_hz=100)  # type: ignore[arg-type]
    before = fingers.channels
    position, force = rest(3)
    with pytest.raises(InvalidArgument, match=said):
        fingers.step(**{"position": position, "force": force, **wrong})
    assert fingers.channels is before
    for ids in ([3], [-1], [0.5]):
        with pytest.raises(InvalidArgument, match="ids"):
            fingers.reset(ids)

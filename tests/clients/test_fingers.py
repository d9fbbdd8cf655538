"""Many fingertips at once are as many streams, each alone."""

import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import taxel
from taxel.errors import InvalidArgument
from taxel.fingers import Fingers, _numbers
from taxel.input_checks import InputCheck
from taxel.local import shipped_repository
from taxel.windows import WindowSpec, WindowStream
from taxel.windows.extras import ExtraFeature
from taxel.windows.fingers import FingerWindows
from taxel.windows.history import (
    BoundedRate,
    Direction,
    Elapsed,
    Friction,
    HistoryFeature,
    Load,
    LoadAbove,
    Play,
    Relaxation,
    RelaxationShare,
    Speed,
    Warmth,
)

HISTORIES: list[HistoryFeature] = [
    Relaxation(of="fz", time_constant_s=0.3),
    Relaxation(of="force", time_constant_s=0.1, starts="rest"),
    Relaxation(of="force", time_constant_s=0.2, whole=True),
    Relaxation(of="fx", time_constant_s=0.2, starts="rest", whole=True),
    RelaxationShare(of="force", time_constant_s=0.1),
    Play(of="fz", width_n=0.4),
    Friction(of="force", width_n=0.4),
    Warmth(of="force", warming_s=0.05, cooling_s=0.3),
    Load(of="force"),
    LoadAbove(of="force", above_n=0.7),
    BoundedRate(of="fz", half_n_s=2.0),
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
    for tick in range(-1000, 1):
        stream.push_ns(10_000_000 * tick, state[0, :3], state[0, 3:])
    windows.prime(np.array([1]), state[:, :3], state[:, 3:])
    moved = state + 0.001
    dt = np.full(2, 10_000_000)
    ids, values = windows.step(np.tile(moved[:, :3], (2, 1)), np.tile(moved[:, 3:], (2, 1)), dt)
    expected = stream.push_ns(10_000_000, moved[0, :3], moved[0, 3:])[-1].values[0]
    assert ids.tolist() == [1]
    elapsed = spec.length + 1 + HISTORIES.index(HISTORIES[-1])
    np.testing.assert_allclose(
        np.delete(values[0], elapsed), np.delete(expected, elapsed), rtol=0, atol=1e-12
    )
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


COUNT, MANY = 4096, 32_768
KINDS: list[Any] = [
    lambda rows: rows,
    torch.from_numpy,
    # Not one after the other in memory, and read-only.
    lambda rows: torch.from_numpy(rows.T.copy()).T,
    lambda rows: np.broadcast_to(rows[:1], rows.shape),
]


def pressed(dtype: Any, rows: int = COUNT) -> tuple[NDArray[Any], NDArray[Any]]:
    random = np.random.default_rng(3)
    position = np.tile([-0.002, 0.0, -0.007], (rows, 1)) + random.normal(0.0, 1e-4, (rows, 3))
    return position.astype(dtype), random.uniform(0.5, 1.0, (rows, 3)).astype(dtype)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_an_array_is_read_where_it_lies(monkeypatch: pytest.MonkeyPatch, dtype: Any, kind: Any) -> None:
    """Up to where its numbers are written down: by the check, and as the newest samples."""
    position, force = map(kind, pressed(dtype))
    read: list[NDArray[Any]] = []

    def spy(owner: type, name: str) -> None:
        original = getattr(owner, name)

        def call(self: Any, place: NDArray[Any], push: NDArray[Any], *others: Any) -> Any:
            read.extend([place, push])
            return original(self, place, push, *others)

        monkeypatch.setattr(owner, name, call)

    spy(InputCheck, "take")
    spy(FingerWindows, "step")
    with taxel.load() as models:
        fingers = models.predictor().fingers(COUNT, rate_hz=1000)
        fingers.step(position, force)
    given = [np.from_dlpack(each) if isinstance(each, torch.Tensor) else each for each in (position, force)]
    for one, own in zip(read, given * 2, strict=True):
        assert one.__array_interface__["data"][0] == own.__array_interface__["data"][0]
        assert (one.dtype, one.strides) == (own.dtype, own.strides)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_step_makes_no_copy_of_its_arrays(dtype: Any, kind: Any) -> None:
    """Neither when they are read and checked, nor in a step between two ticks."""
    position, force = map(kind, pressed(dtype, MANY))
    windows = FingerWindows(WindowSpec.of(5), MANY, rate_hz=1000)
    size = MANY * 3 * np.dtype(dtype).itemsize

    def peak(call: Callable[[], Any]) -> int:
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        call()
        return tracemalloc.get_traced_memory()[1] - before

    tracemalloc.start()
    try:
        reading = peak(lambda: _numbers("position", position, (MANY, 3)))
        places, forces = (_numbers("", each, (MANY, 3)) for each in (position, force))
        windows.step(places, forces, 1_000_000)
        stepping = peak(lambda: windows.step(places, forces, 1_000_000))
    finally:
        tracemalloc.stop()
    # NumPy goes through strided numbers in buffers, however many there are.
    assert reading < 100_000 < size / 3
    # For each fingertip a time of 8 bytes, and flags of one.
    assert stepping < 16 * MANY < 2 * size


@pytest.mark.parametrize("rate", [100.0, 500.0])
def test_numbers_of_any_type_give_the_same_channels(rate: float) -> None:
    random = np.random.default_rng(4)
    with taxel.load() as models:
        predictor = models.predictor()
        expected, *others = (predictor.fingers(8, rate_hz=rate) for _ in range(3))
        for _ in range(30):
            position, force = pressed(np.float32, 8)
            force *= np.float32(random.uniform())
            dt = (random.uniform(0.9, 1.1, 8) / rate).astype(np.float32)
            as_64 = [each.astype(np.float64) for each in (position, force, dt)]
            channels = expected.step(*as_64)
            np.testing.assert_array_equal(others[0].step(position, force, dt), channels)
            tensors: list[Any] = [torch.from_numpy(each) for each in (position, force, dt)]
            np.testing.assert_array_equal(others[1].step(*tensors), channels)
            # The past is the fingers' own.
            position[:], force[:] = 9.0, 9.0
            assert not np.isnan(channels).any()


@pytest.mark.parametrize("dtype", [np.float16, np.int64, np.bool_, np.dtype(">f4")])
def test_other_real_numbers_are_taken(dtype: Any) -> None:
    fingers = Fingers(Echo(), 2, rate_hz=100)  # type: ignore[arg-type]
    assert (fingers.step(np.ones((2, 3), dtype), np.zeros((2, 3), dtype)) == 1.0).all()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"position": np.zeros((2, 3))}, r"position has shape \(2, 3\): expected \(3, 3\)"),
        ({"force": np.full((3, 3), np.nan)}, r"force\[0\] is \[nan, nan, nan\]: expected finite"),
        ({"force": np.full((3, 3), -np.inf, np.float32)}, r"force\[0\] is \[-inf, .*: expected finite"),
        ({"force": np.full((3, 3), np.nan, np.float16)}, r"force\[0\] is \[nan, .*: expected finite"),
        ({"force": np.full((3, 3), 1j)}, "force: complex numbers: expected numbers"),
        ({"force": np.full((3, 3), 1e300)}, r"force\[0\] is \[1e\+300, .*: expected finite"),
        ({"dt": 0.0}, "dt is 0.0: expected more than 0 s"),
        ({"dt": [0.01, 1e30, 0.01]}, r"dt\[1\] is 1e\+30: expected finite numbers, at most 1e\+06"),
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

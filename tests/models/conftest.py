"""Small recordings, and a smooth model with recordings that it explains but for noise."""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray

from taxel import artifacts
from taxel_models.loop.observations import Observations, gather
from taxel_models.recordings import Recording
from taxel_models.shipped import shipped_repository
from taxel_models.twin import simulate

ROWS: Final = 9_000
NOISE: Final = 4.0
"""SD of every channel's noise, counts."""

REST: Final = np.array([2040.0, 1500.0, *np.linspace(2400.0, 3000.0, 19)])

Make = Callable[..., Recording]


class SmoothModel:
    """counts = rest + tanh of the force + a share of the place that grows with the force."""

    def __init__(self) -> None:
        shipped = artifacts.read(shipped_repository() / "network-b" / "1").manifest
        # What the shipped model gets wrong is nothing of this one.
        self.manifest: Final = shipped.model_copy(update={"held_out_residual": None})
        random = np.random.default_rng(5)
        self._by_force = random.normal(size=(3, 21)) / 6.0
        self._by_place = random.normal(size=(3, 21)) * 60.0

    def counts(self, position: NDArray[np.floating], force: NDArray[np.floating]) -> NDArray[np.float64]:
        """(n, 21) of positions (n, 3), m, and forces (n, 3), N."""
        size = np.linalg.norm(force, axis=1, keepdims=True)
        places = np.tanh(position / 0.01) @ self._by_place
        return np.asarray(REST + 350.0 * np.tanh(force @ self._by_force) + size / (size + 1.0) * places)

    def predict_base(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The same as `predict`: it is not corrected."""
        return self.predict(windows)

    def predict(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """As a predictor of input combination 1 does, of its position and its force at T."""
        values = windows.astype(np.float64)
        return self.counts(values[:, :3], values[:, 3:6]).astype(np.float32)


@pytest.fixture(scope="session")
def smooth() -> SmoothModel:
    return SmoothModel()


@pytest.fixture(scope="session")
def make(smooth: SmoothModel) -> Make:
    """Recordings of the twin's contacts whose channels are the smooth model's with white noise.

    With `materials`, a column `material` takes one of five values for three seconds at a time.
    """

    def made(rows: int = ROWS, seed: int = 3, noise: float = NOISE, *, materials: bool = True) -> Recording:
        recording = simulate(rows, seed)
        random = np.random.default_rng(seed)
        counts = smooth.counts(recording.samples.position, recording.samples.force)
        counts += random.normal(size=counts.shape) * noise
        recording = replace(recording, channels=np.clip(np.rint(counts), 0, 4095))
        if not materials:
            return recording
        material = np.repeat(random.integers(1, 6, rows // 300 + 1), 300)[:rows]
        return replace(recording, covariates={"material": material.astype(np.float64)})

    return made


@pytest.fixture(scope="session")
def recording(make: Make) -> Recording:
    return make()


@pytest.fixture(scope="session")
def observations(smooth: SmoothModel, recording: Recording) -> Observations:
    """The recording beside the model: a residual of nothing but noise."""
    return gather(smooth, [recording])


@pytest.fixture
def make_recording() -> Callable[..., Recording]:
    """Recordings whose channels are a simple function of position and force."""

    def make(segment_rows: list[int], seed: int = 0) -> Recording:
        rng = np.random.default_rng(seed)
        rows = sum(segment_rows)
        time = np.arange(rows) * 10_000_000
        for start in np.cumsum(segment_rows)[:-1]:
            time[start:] += 1_000_000_000
        force = rng.normal(size=(rows, 3))
        position = np.repeat(rng.normal(size=(rows // 10 + 1, 3)), 10, axis=0)[:rows] * 1e-3
        gains = rng.normal(size=(6, 21)) * 50
        channels = 2000 + np.column_stack([position * 1e3, force]) @ gains
        auxiliary = {name: rng.integers(1000, 2000, rows) for name in ("pac1", "tac", "tdc")}
        return Recording.of(time, position, force, channels, auxiliary, name=f"made{seed}")

    return make

from collections.abc import Callable

import numpy as np
import pytest

from taxel_models.recordings import Recording


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

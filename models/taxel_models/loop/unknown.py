"""Causes that no effect class describes, for the trial: they must be called unexplained."""

from collections.abc import Callable
from typing import Final

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.loop.planting import Planting


def hum(planting: Planting) -> None:
    """A periodic disturbance of 0.3 to 3 Hz, of its own amplitude in each channel."""
    frequency = float(planting.random.uniform(0.3, 3.0))
    phase = planting.random.uniform(0.0, 2 * np.pi)
    wave = np.sin(2 * np.pi * frequency * planting.time_s + phase)
    weights = planting.random.normal(size=len(CHANNELS)) * planting.residual
    planting.add(wave[:, None] * weights, {"amplitude": weights}, frequency=frequency)


def telegraph(planting: Planting) -> None:
    """All channels jump between two levels at random times, some seconds apart."""
    jumps = planting.random.random(len(planting.recording)) < 0.01 / float(planting.random.uniform(1, 4))
    level = np.where(np.cumsum(jumps) % 2, 1.0, -1.0)
    weights = planting.random.normal(size=len(CHANNELS)) * planting.residual
    planting.add((level - level.mean())[:, None] * weights, {"amplitude": weights})


def bursts(planting: Planting) -> None:
    """Noise that comes and goes in stretches of a few seconds."""
    random = planting.random
    gate = np.repeat(random.random(len(planting.recording) // 300 + 1) < 0.3, 300)[
        : len(planting.recording)
    ]
    noise = random.normal(size=(len(gate), len(CHANNELS))) * planting.residual
    smooth = np.apply_along_axis(lambda column: np.convolve(column, np.ones(5) / 5, "same"), 0, noise)
    planting.add(gate[:, None] * smooth, {})


UNKNOWN: Final[dict[str, Callable[[Planting], None]]] = {
    "hum": hum,
    "telegraph": telegraph,
    "bursts": bursts,
}

"""Causes that no effect describes. The loop must report them as unexplained."""

from collections.abc import Callable
from typing import Final

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.recovery.injection import Injection


def telegraph(injection: Injection) -> None:
    """All channels jump between two levels at random times, some seconds apart."""
    jumps = injection.random.random(len(injection.recording)) < 0.01 / float(injection.random.uniform(1, 4))
    level = np.where(np.cumsum(jumps) % 2, 1.0, -1.0)
    weights = injection.random.normal(size=len(CHANNELS)) * injection.residual
    injection.add((level - level.mean())[:, None] * weights, {"amplitude": weights})


def bursts(injection: Injection) -> None:
    """Noise that comes and goes in stretches of a few seconds."""
    random = injection.random
    gate = np.repeat(random.random(len(injection.recording) // 300 + 1) < 0.3, 300)[
        : len(injection.recording)
    ]
    noise = random.normal(size=(len(gate), len(CHANNELS))) * injection.residual
    smooth = np.apply_along_axis(lambda column: np.convolve(column, np.ones(5) / 5, "same"), 0, noise)
    injection.add(gate[:, None] * smooth, {})


UNKNOWN: Final[dict[str, Callable[[Injection], None]]] = {
    "telegraph": telegraph,
    "bursts": bursts,
}

"""Causes that no effect describes: nothing is right but to name nothing."""

import numpy as np
from scipy.signal import lfilter

from taxel.channels import CHANNELS
from taxel_models.foreign.planting import Planting


def wander(planting: Planting) -> None:
    """Each channel wanders by itself, within about a second (an Ornstein-Uhlenbeck process)."""
    keep = float(np.exp(-0.01 / planting.random.uniform(0.3, 1.5)))
    steps = planting.random.standard_normal((len(planting), len(CHANNELS)))
    planting.add(np.asarray(lfilter([1.0], [1.0, -keep], steps, axis=0)) * planting.deviation)


def chirp(planting: Planting) -> None:
    """A wave whose frequency sweeps up and down between 0.2 and 8 Hz."""
    sweep = 4.1 + 3.9 * np.sin(2 * np.pi * planting.time_s / planting.random.uniform(20.0, 60.0))
    phase = 2 * np.pi * np.cumsum(sweep) * 0.01
    planting.add(np.sin(phase)[:, None] * planting.free_weights())


def shocks(planting: Planting) -> None:
    """Discharges at random moments, which fade within 0.1 to 0.5 s, with signs of their own."""
    random = planting.random
    keep = float(np.exp(-0.01 / random.uniform(0.1, 0.5)))
    struck = (random.random(len(planting)) < 0.008) * random.standard_normal(len(planting))
    planting.add(np.asarray(lfilter([1.0], [1.0, -keep], struck))[:, None] * planting.free_weights())


def noise(planting: Planting) -> None:
    """Noise whose size changes from second to second."""
    random = planting.random
    sizes = np.repeat(random.exponential(1.0, len(planting) // 100 + 1), 100)[: len(planting)]
    planting.add(
        sizes[:, None] * random.standard_normal((len(planting), len(CHANNELS))) * planting.deviation
    )

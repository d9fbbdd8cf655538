"""Causes that no effect describes: nothing is right but to name nothing."""

import numpy as np
from scipy.signal import lfilter

from taxel.channels import CHANNELS
from taxel.windows.history import TICK_S
from taxel_models.foreign.injection import ForeignInjection


def wander(injection: ForeignInjection) -> None:
    """Each channel wanders by itself, within about a second (an Ornstein-Uhlenbeck process)."""
    keep = float(np.exp(-TICK_S / injection.random.uniform(0.3, 1.5)))
    steps = injection.random.standard_normal((len(injection), len(CHANNELS)))
    injection.add(np.asarray(lfilter([1.0], [1.0, -keep], steps, axis=0)) * injection.deviation)


def chirp(injection: ForeignInjection) -> None:
    """A wave whose frequency sweeps up and down between 0.2 and 8 Hz."""
    sweep = 4.1 + 3.9 * np.sin(2 * np.pi * injection.time_s / injection.random.uniform(20.0, 60.0))
    phase = 2 * np.pi * np.cumsum(sweep) * TICK_S
    injection.add(np.sin(phase)[:, None] * injection.free_weights())


def shocks(injection: ForeignInjection) -> None:
    """Discharges at random moments, which fade within 0.1 to 0.5 s, with signs of their own."""
    random = injection.random
    keep = float(np.exp(-TICK_S / random.uniform(0.1, 0.5)))
    struck = (random.random(len(injection)) < 0.008) * random.standard_normal(len(injection))
    injection.add(np.asarray(lfilter([1.0], [1.0, -keep], struck))[:, None] * injection.free_weights())


def noise(injection: ForeignInjection) -> None:
    """Noise whose size changes from second to second."""
    random = injection.random
    sizes = np.repeat(random.exponential(1.0, len(injection) // 100 + 1), 100)[: len(injection)]
    injection.add(
        sizes[:, None] * random.standard_normal((len(injection), len(CHANNELS))) * injection.deviation
    )

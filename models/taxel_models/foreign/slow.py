"""Changes over a session: drifts of other shapes, and temperature."""

from typing import Final

import numpy as np

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.windows.history import TICK_S
from taxel_models.foreign.injection import Floats, ForeignInjection

REFERENCE_OHM: Final = 10_000.0
"""The converter's resistor: Z = (4095/E - 1) 10 kOhm (SynTouch, BioTac product manual V2)."""


def drift_linear(injection: ForeignInjection) -> None:
    """A line over the session."""
    _drift(injection, injection.time_s)


def drift_warming(injection: ForeignInjection) -> None:
    """1 - exp(-t/tau), as after switching on."""
    tau = float(injection.random.uniform(0.15, 0.6)) * injection.time_s[-1]
    _drift(injection, -np.expm1(-injection.time_s / tau), time_constant=tau)


def drift_saturating(injection: ForeignInjection) -> None:
    """t²/(t² + tau²): it begins slowly, and ends."""
    tau = float(injection.random.uniform(0.2, 0.5)) * injection.time_s[-1]
    _drift(injection, injection.time_s**2 / (injection.time_s**2 + tau**2), time_constant=tau)


def drift_stepwise(injection: ForeignInjection) -> None:
    """Two to five steps of one sign, each at once."""
    steps = np.sort(injection.random.uniform(0.05, 0.95, int(injection.random.integers(2, 6))))
    heights = np.cumsum(injection.random.uniform(0.5, 1.5, len(steps) + 1))
    _drift(injection, heights[np.searchsorted(steps, injection.time_s / injection.time_s[-1])])


def _drift(injection: ForeignInjection, course: Floats, **parameters: float) -> None:
    injection.add(course[:, None] * injection.free_weights(), **parameters)


def temperature_measured(injection: ForeignInjection) -> None:
    """Conductivity follows the measured temperature; slopes of one sign, alike within a quarter."""
    _conducts(injection, injection.recording.auxiliary["tdc"])


def temperature_contact(injection: ForeignInjection) -> None:
    """The finger warms while it is pressed and cools in the air, at another rate (Newton's law of cooling).

    The measured temperature follows it.
    """
    warming, cooling = injection.random.uniform(4.0, 12.0), injection.random.uniform(20.0, 60.0)
    steps = np.diff(injection.time_s, prepend=injection.time_s[0])
    touch = injection.load / (injection.load + 0.5)
    # A gap between rows is time in the air.
    air = np.where(steps > 0.1, steps, 0.0)
    steps = np.where(steps > 0.1, TICK_S, steps)
    state, states = 0.0, np.empty(len(injection))
    for row in range(len(injection)):
        state *= float(np.exp(-air[row] / cooling))
        state += steps[row] * (touch[row] * (1.0 - state) / warming - (1.0 - touch[row]) * state / cooling)
        states[row] = state
    injection.replace_temperature(injection.recording.auxiliary["tdc"] + 40.0 * (states - states.mean()))
    _conducts(injection, states, warming_s=float(warming), cooling_s=float(cooling))


def _conducts(injection: ForeignInjection, warmth: Floats, **parameters: float) -> None:
    """ln Z of each electrode shifts in proportion to a warmth (n,); tared electrodes shift in counts."""
    sd = float(warmth.std())
    warmer = (warmth - warmth.mean()) / sd if sd > 0 else np.zeros_like(warmth)
    slopes = np.maximum(1.0 + 0.25 * injection.random.standard_normal(len(CHANNELS)), 0.3)
    slopes *= injection.random.choice([-1.0, 1.0])
    slopes[:2] = 0.0
    if injection.tared:
        injection.add(warmer[:, None] * slopes * injection.deviation.mean(), **parameters)
        return
    counts = np.clip(injection.counts, 1.0, COUNTS_MAX - 1.0)
    ohm = (COUNTS_MAX / counts - 1.0) * REFERENCE_OHM
    moved = COUNTS_MAX / (1.0 + ohm * np.exp(0.02 * warmer[:, None] * slopes) / REFERENCE_OHM)
    change = moved - counts
    change[:, :2] = 0.0
    injection.add(change, **parameters)

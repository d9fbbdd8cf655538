"""Changes over a session: drifts of other shapes, and temperature."""

from typing import Final

import numpy as np

from taxel.channels import COUNTS_MAX
from taxel_models.foreign.planting import Floats, Planting

REFERENCE_OHM: Final = 10_000.0
"""The converter's resistor: Z = (4095/E - 1) 10 kOhm (SynTouch, BioTac product manual V2)."""


def drift_linear(planting: Planting) -> None:
    """A line over the session."""
    _drift(planting, planting.time_s)


def drift_warming(planting: Planting) -> None:
    """1 - exp(-t/tau), as after switching on."""
    tau = float(planting.random.uniform(0.15, 0.6)) * planting.time_s[-1]
    _drift(planting, -np.expm1(-planting.time_s / tau), time_constant=tau)


def drift_saturating(planting: Planting) -> None:
    """t²/(t² + tau²): it begins slowly, and ends."""
    tau = float(planting.random.uniform(0.2, 0.5)) * planting.time_s[-1]
    _drift(planting, planting.time_s**2 / (planting.time_s**2 + tau**2), time_constant=tau)


def drift_stepwise(planting: Planting) -> None:
    """Two to five steps of one sign, each at once."""
    steps = np.sort(planting.random.uniform(0.05, 0.95, int(planting.random.integers(2, 6))))
    heights = np.cumsum(planting.random.uniform(0.5, 1.5, len(steps) + 1))
    _drift(planting, heights[np.searchsorted(steps, planting.time_s / planting.time_s[-1])])


def _drift(planting: Planting, course: Floats, **parameters: float) -> None:
    planting.add(course[:, None] * planting.free_weights(), **parameters)


def temperature_measured(planting: Planting) -> None:
    """Conductivity follows the measured temperature; slopes of one sign, alike within a quarter."""
    _conducts(planting, planting.recording.auxiliary["tdc"])


def temperature_contact(planting: Planting) -> None:
    """The finger warms while it is pressed and cools in the air, at another rate (Newton's law of cooling).

    The measured temperature follows it.
    """
    warming, cooling = planting.random.uniform(4.0, 12.0), planting.random.uniform(20.0, 60.0)
    steps = np.diff(planting.time_s, prepend=planting.time_s[0])
    touch = planting.load / (planting.load + 0.5)
    # A gap between rows is time in the air.
    air = np.where(steps > 0.1, steps, 0.0)
    steps = np.where(steps > 0.1, 0.01, steps)
    state, states = 0.0, np.empty(len(planting))
    for row in range(len(planting)):
        state *= float(np.exp(-air[row] / cooling))
        state += steps[row] * (touch[row] * (1.0 - state) / warming - (1.0 - touch[row]) * state / cooling)
        states[row] = state
    planting.replace_temperature(planting.recording.auxiliary["tdc"] + 40.0 * (states - states.mean()))
    _conducts(planting, states, warming_s=float(warming), cooling_s=float(cooling))


def _conducts(planting: Planting, warmth: Floats, **parameters: float) -> None:
    """ln Z of each electrode shifts in proportion to a warmth (n,); tared electrodes shift in counts."""
    spread = float(warmth.std())
    warmer = (warmth - warmth.mean()) / spread if spread > 0 else np.zeros_like(warmth)
    slopes = np.maximum(1.0 + 0.25 * planting.random.standard_normal(21), 0.3)
    slopes *= planting.random.choice([-1.0, 1.0])
    slopes[:2] = 0.0
    if planting.tared:
        planting.add(warmer[:, None] * slopes * planting.deviation.mean(), **parameters)
        return
    counts = np.clip(planting.counts, 1.0, COUNTS_MAX - 1.0)
    ohm = (COUNTS_MAX / counts - 1.0) * REFERENCE_OHM
    moved = COUNTS_MAX / (1.0 + ohm * np.exp(0.02 * warmer[:, None] * slopes) / REFERENCE_OHM)
    change = moved - counts
    change[:, :2] = 0.0
    planting.add(change, **parameters)

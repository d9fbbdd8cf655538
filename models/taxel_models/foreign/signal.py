"""Electronics and places: saturation, crosstalk, interference, worn patches."""

from collections.abc import Callable

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.foreign.injection import Floats, ForeignInjection


def saturation(injection: ForeignInjection) -> None:
    """s / (1 + |s/L|^p)^(1/p): the signal bends towards a level L (Rapp's amplifier)."""
    signal, power = injection.signal, float(injection.random.uniform(2.0, 5.0))
    highest = np.abs(signal).max(axis=0) + 1e-9

    def bent(level: float) -> Floats:
        ratio = np.abs(signal) / (level * highest)
        return np.asarray(signal * ((1.0 + ratio**power) ** (-1.0 / power) - 1.0))

    injection.add_nearest(
        ((level, bent(level)) for level in np.geomspace(0.1, 3.0, 16)), "level", power=power
    )


def crosstalk(injection: ForeignInjection) -> None:
    """The converter keeps some charge of the electrode that it read before, more while that one changes."""
    columns = np.sort(injection.electrodes)
    first = int(injection.random.integers(len(columns) - 4))
    length = int(injection.random.integers(2, 5))
    signal = injection.signal
    rate = injection.in_segments(lambda part: np.gradient(part, axis=0), signal)
    change = np.zeros_like(signal)
    for before, after in zip(columns[first:], columns[first + 1 : first + 1 + length], strict=False):
        leak = signal[:, before] + 2.0 * rate[:, before]
        change[:, after] = leak * injection.deviation[after] / max(float(leak.std()), 1e-9)
    injection.add(change, channels=[CHANNELS[one] for one in columns[first : first + length + 1]])


def interference(injection: ForeignInjection) -> None:
    """A frequency of 0.5 to 45 Hz with two harmonics, in 4 to 12 channels."""
    random = injection.random
    frequency = float(random.uniform(0.5, 45.0))
    chosen = random.permutation(np.flatnonzero(injection.live))[: int(random.integers(4, 13))]
    change = np.zeros_like(injection.counts)
    for harmonic, size in ((1, 1.0), (2, 0.4), (3, 0.2)):
        phase = 2 * np.pi * (harmonic * frequency * injection.time_s + random.random())
        change[:, chosen] += size * np.sin(phase)[:, None] * injection.deviation[chosen]
    injection.add(change, frequency=frequency, channels=[CHANNELS[one] for one in chosen])


def place_gain(injection: ForeignInjection) -> None:
    """Sensitivity differs at a few places: Cauchy's bumps 1 / (1 + d²/w²)."""
    _places(injection, lambda distance: 1.0 / (1.0 + distance**2))


def place_patch(injection: ForeignInjection) -> None:
    """Worn patches: raised cosines that end at a distance."""
    _places(injection, lambda distance: np.where(distance < 2.0, 1.0 + np.cos(np.pi * distance / 2.0), 0.0))


def _places(injection: ForeignInjection, bump: Callable[[Floats], Floats]) -> None:
    """At five places that were touched, each of 1.5 to 4 mm, the signals change by a share of their own."""
    position = injection.recording.samples.position
    touched = position[injection.load > np.quantile(injection.load, 0.5)]
    change = np.zeros_like(injection.counts)
    for centre in touched[injection.random.integers(len(touched), size=5)]:
        width = float(injection.random.uniform(1.5e-3, 4e-3))
        distance = np.linalg.norm(position - centre, axis=1) / width
        change += (
            injection.signal * bump(distance)[:, None] * injection.random.uniform(-1.0, 1.0, len(CHANNELS))
        )
    injection.add(change)

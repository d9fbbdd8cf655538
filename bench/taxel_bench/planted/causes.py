"""What is planted: plain formulas of counts, force and time. They share nothing with the loop."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS

Floats = NDArray[np.float64]

ELECTRODES: Final = np.arange(len(CHANNELS))[ELECTRODE_COLUMNS]
"""The columns of `Planting.counts` that are changed; `pac0` and `pdc` stay as they are."""

SMALL, LARGE = 0.35, 0.7
"""How large a cause is: about half a channel's standard deviation."""


@dataclass
class Planting:
    """A recording, trial after trial in time, to plant causes in.

    Attributes:
        counts: (n, 21), which a cause changes.
        trial: (n,) number of the trial, from 0 on.
        time_s: (n,) s.
        force_n: (n,) size of the force, N.
        tdc: (n,) counts of the thermistor.
        random: chooses channels and sizes.
    """

    counts: Floats
    trial: NDArray[np.int64]
    time_s: Floats
    force_n: Floats
    tdc: Floats
    random: np.random.Generator

    def __post_init__(self) -> None:
        self.std = self.counts.std(axis=0)
        self.rest = np.quantile(self.counts, 0.02, axis=0)
        self.recorded = np.arange(len(self.counts)) / len(self.counts)

    def electrode(self) -> int:
        """The column of an electrode by chance."""
        return int(self.random.choice(ELECTRODES))

    def add(self, course: Floats) -> None:
        """To each electrode, a course (n,) about its mean, with a weight of its own."""
        unit = (course - course.mean()) / course.std()
        self.counts = self.counts + unit[:, None] * self.constants()

    def constants(self) -> Floats:
        """(21,) counts by chance; 0 for channels that stay as they are."""
        weights = np.zeros(len(self.std))
        weights[ELECTRODES] = self.random.normal(size=len(ELECTRODES))
        return np.asarray(weights * self.random.uniform(SMALL, LARGE) * self.std)

    def by_trial(self, values: Floats, of_trial: Callable[[Floats, Floats], Floats]) -> Floats:
        """(n,) what a function of time and values (m,) gives of each trial."""
        parts = (self.trial == number for number in range(int(self.trial.max()) + 1))
        return np.concatenate([of_trial(self.time_s[rows], values[rows]) for rows in parts])

    def low_passed(self, tau_s: float) -> Floats:
        """(n,) the force through a first-order low-pass that begins at 0 in each trial."""

        def passed(time_s: Floats, force_n: Floats) -> Floats:
            held, found = 0.0, np.zeros_like(force_n)
            for row in range(1, len(force_n)):
                share = 1.0 - np.exp(-max(time_s[row] - time_s[row - 1], 0.0) / tau_s)
                held += share * (force_n[row] - held)
                found[row] = held
            return found

        return self.by_trial(self.force_n, passed)


def _offset(one: Planting) -> None:
    one.counts = one.counts + one.constants()


def _contact_offset(one: Planting) -> None:
    each = np.array([one.constants() for _ in range(int(one.trial.max()) + 1)])
    one.counts = one.counts + each[one.trial]


def _creep(one: Planting) -> None:
    """The force's low-pass, or what the force is ahead of it: of both, the model has absorbed the mean."""
    late = one.low_passed(float(one.random.choice([1.0, 2.0, 4.0])))
    one.add(late - one.random.choice([0.0, 1.0]) * one.force_n)


def _hysteresis(one: Planting) -> None:
    """A backlash: the force is followed once it has moved by more than the play."""
    play = one.random.uniform(0.3, 0.7) * one.force_n.std()

    def backlash(_: Floats, force_n: Floats) -> Floats:
        state, found = 0.0, np.empty_like(force_n)
        for row, force in enumerate(force_n):
            state = min(max(state, force - play), force + play)
            found[row] = state
        return found

    one.add(one.by_trial(one.force_n, backlash) - one.force_n)


def _rate(one: Planting) -> None:
    rate = one.by_trial(one.low_passed(0.05), lambda _, force_n: np.gradient(force_n))
    most = 4.0 * rate.std()
    one.add(np.clip(rate, -most, most))


def _drift(one: Planting) -> None:
    one.add(one.random.choice([one.recorded, 1.0 - np.exp(-one.recorded / 0.2)]))


def _temperature(one: Planting) -> None:
    one.add(one.tdc)


def _gain(one: Planting) -> None:
    gain = np.ones(len(one.std))
    gain[ELECTRODES] = one.random.uniform(0.6, 1.5, size=len(ELECTRODES))
    one.counts = one.rest + (one.counts - one.rest) * gain


def _gain_of_one(one: Planting) -> None:
    column, gain = one.electrode(), float(one.random.choice([0.3, 0.5, 1.6]))
    one.counts[:, column] = one.rest[column] + (one.counts[:, column] - one.rest[column]) * gain


def _fading(one: Planting) -> None:
    """An electrode loses 70 % of its signal, evenly, at once or by an exponential."""
    lost = one.random.choice([one.recorded, one.recorded > 0.5, 1.0 - np.exp(-one.recorded / 0.3)])
    column = one.electrode()
    one.counts[:, column] -= 0.7 * lost * (one.counts[:, column] - one.rest[column])


def _stuck(one: Planting) -> None:
    column, since = one.electrode(), int(one.trial.max()) // 2
    rows = one.trial > since
    one.counts[rows, column] = one.counts[rows, column][0]


def _crosstalk(one: Planting) -> None:
    to, source = one.random.permutation(ELECTRODES)[:2]
    share = one.random.uniform(SMALL, LARGE) * one.std[to] / one.std[source]
    one.counts[:, to] += share * (one.counts[:, source] - one.rest[source])


def _saturation(one: Planting) -> None:
    level = np.quantile(one.counts, one.random.uniform(0.8, 0.92), axis=0)
    above = np.maximum(one.counts - level, 0.0)
    one.counts[:, ELECTRODES] -= (1.0 - one.random.uniform(0.1, 0.4)) * above[:, ELECTRODES]


def _interference(one: Planting) -> None:
    wave = np.sin(2.0 * np.pi * one.random.uniform(2.0, 40.0) * one.time_s)
    some = one.random.permutation(ELECTRODES)[:4]
    one.counts[:, some] += LARGE * wave[:, None] * one.std[some]


def _delay(ticks: int) -> Callable[[Planting], None]:
    def delayed(one: Planting) -> None:
        rows = np.arange(len(one.counts))
        first = np.searchsorted(one.trial, one.trial)
        one.counts = one.counts[np.maximum(rows - ticks, first)]

    return delayed


PLANTED: Final[dict[str, tuple[Callable[[Planting], None], str]]] = {
    "offset": (_offset, "offset"),
    "contact offset": (_contact_offset, "offset:contact"),
    "creep": (_creep, "creep"),
    "hysteresis": (_hysteresis, "hysteresis"),
    "rate": (_rate, "rate"),
    "drift": (_drift, "drift"),
    "temperature": (_temperature, "temperature"),
    "gain": (_gain, "gain"),
    "gain of one": (_gain_of_one, "gain"),
    "fading": (_fading, "gain"),
    "stuck": (_stuck, "fault"),
    "crosstalk": (_crosstalk, "crosstalk"),
    "saturation": (_saturation, "saturation"),
    "interference": (_interference, "interference"),
    "delay 20 ms": (_delay(2), "lag"),
    "delay 40 ms": (_delay(4), "lag"),
}
"""What plants each cause, and the loop's name of it."""

PAIRS: Final = (("offset", "creep"), ("hysteresis", "offset"), ("creep", "drift"), ("gain", "delay 40 ms"))

EVERY: Final = ((), *((name,) for name in PLANTED), *PAIRS)
"""All that is planted by default: nothing, one cause, two."""

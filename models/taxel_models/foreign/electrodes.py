"""Electrodes that fail: they lose sensitivity, come and go, stay where they are, or are exchanged."""

from collections.abc import Callable
from itertools import combinations

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.foreign.injection import Floats, ForeignInjection


def dying_linearly(injection: ForeignInjection) -> None:
    """Sensitivity falls along a line over the session."""
    _dying(injection, lambda share: share)


def dying_exponentially(injection: ForeignInjection) -> None:
    """Sensitivity falls fast at first, then more slowly."""
    rate = float(injection.random.uniform(2.0, 6.0))
    _dying(injection, lambda share: -np.expm1(-rate * share) / -np.expm1(-rate))


def dying_stepwise(injection: ForeignInjection) -> None:
    """Sensitivity falls in two to four steps."""
    steps = np.sort(injection.random.uniform(0.1, 0.9, int(injection.random.integers(2, 5))))
    _dying(injection, lambda share: np.searchsorted(steps, share) / len(steps))


def _dying(injection: ForeignInjection, lost: Callable[[Floats], Floats]) -> None:
    """One electrode keeps a share of its sensitivity that is as near to the strength as it can be."""
    course = np.asarray(lost(injection.time_s / injection.time_s[-1]), dtype=np.float64)
    columns = injection.electrodes
    fallen = -injection.signal * course[:, None]
    fallen -= fallen.mean(axis=0)
    whole = fallen.std(axis=0) / injection.deviation
    able = [column for column in columns if whole[column] >= injection.strength]
    channel = int(able[0] if able else columns[np.argmax(whole[columns])])
    share = min(injection.strength / max(float(whole[channel]), 1e-9), 1.0)
    change = np.zeros_like(injection.counts)
    change[:, channel] = fallen[:, channel] * share
    injection.add_nearest([(1.0 - share, change)], "sensitivity_left", channel=CHANNELS[channel])


def intermittent(injection: ForeignInjection) -> None:
    """A loose wire: the electrode loses its signal at random times, for 0.1 to 2 s."""
    random = injection.random
    away = np.zeros(len(injection), np.bool_)
    row = 0
    while row < len(injection):
        row += 1 + int(random.exponential(150.0))
        last = row + 10 + int(random.exponential(60.0))
        away[row:last] = True
        row = last
    noise = np.rint(0.5 * random.standard_normal(len(injection)))
    changed = {
        int(column): np.where(away, injection.unloaded[column] + noise, injection.counts[:, column])
        for column in injection.electrodes
    }
    injection.replace_one(changed, away=float(away.mean()))


def stuck(injection: ForeignInjection) -> None:
    """From some moment on, the electrode repeats a usual reading."""
    first = int(injection.random.uniform(0.05, 0.6) * len(injection))
    changed = {}
    for column in injection.electrodes:
        counts = injection.counts[:, column].copy()
        counts[first:] = np.rint(counts[first - min(first, 100) : first + 1].mean())
        changed[int(column)] = counts
    injection.replace_one(changed, since=float(injection.time_s[first]))


def crossed(injection: ForeignInjection) -> None:
    """Two electrodes' wires are exchanged: of all pairs, one of the three nearest to the strength."""
    counts = injection.counts
    pairs = [pair for pair in combinations(injection.electrodes, 2) if injection.live[list(pair)].all()]
    apart = []
    for one, other in pairs:
        change = np.zeros_like(counts)
        change[:, one] = counts[:, other] - counts[:, one]
        change[:, other] = -change[:, one]
        apart.append(abs(np.log(max(injection.strength_of(change), 1e-9) / injection.strength)))
    one, other = pairs[int(injection.random.choice(np.argsort(apart)[:3]))]
    exchanged = counts.copy()
    exchanged[:, [one, other]] = counts[:, [other, one]]
    injection.replace_counts(exchanged, channels=[CHANNELS[one], CHANNELS[other]])

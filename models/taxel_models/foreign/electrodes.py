"""Single electrodes that fail: they lose sensitivity, come and go, or stay where they are."""

from collections.abc import Callable

import numpy as np

from taxel.channels import CHANNELS
from taxel_models.foreign.planting import Floats, Planting


def dying_linearly(planting: Planting) -> None:
    """Sensitivity falls along a line over the session."""
    _dying(planting, lambda share: share)


def dying_exponentially(planting: Planting) -> None:
    """Sensitivity falls fast at first, then more slowly."""
    rate = float(planting.random.uniform(2.0, 6.0))
    _dying(planting, lambda share: -np.expm1(-rate * share) / -np.expm1(-rate))


def dying_stepwise(planting: Planting) -> None:
    """Sensitivity falls in two to four steps."""
    steps = np.sort(planting.random.uniform(0.1, 0.9, int(planting.random.integers(2, 5))))
    _dying(planting, lambda share: np.searchsorted(steps, share) / len(steps))


def _dying(planting: Planting, lost: Callable[[Floats], Floats]) -> None:
    """One electrode keeps a share of its sensitivity that is as near to the strength as it can be."""
    course = np.asarray(lost(planting.time_s / planting.time_s[-1]), dtype=np.float64)
    columns = planting.electrodes
    fallen = -planting.signal * course[:, None]
    fallen -= fallen.mean(axis=0)
    whole = fallen.std(axis=0) / planting.deviation
    able = [column for column in columns if whole[column] >= planting.strength]
    channel = int(able[0] if able else columns[np.argmax(whole[columns])])
    share = min(planting.strength / max(float(whole[channel]), 1e-9), 1.0)
    change = np.zeros_like(planting.counts)
    change[:, channel] = fallen[:, channel] * share
    planting.add_nearest([(1.0 - share, change)], "sensitivity_left", channel=CHANNELS[channel])


def intermittent(planting: Planting) -> None:
    """A loose wire: the electrode loses its signal at random times, for 0.1 to 2 s."""
    random = planting.random
    away = np.zeros(len(planting), np.bool_)
    row = 0
    while row < len(planting):
        row += 1 + int(random.exponential(150.0))
        last = row + 10 + int(random.exponential(60.0))
        away[row:last] = True
        row = last
    noise = np.rint(0.5 * random.standard_normal(len(planting)))
    changed = {
        int(column): np.where(away, planting.unloaded[column] + noise, planting.counts[:, column])
        for column in planting.electrodes
    }
    planting.replace_one(changed, away=float(away.mean()))


def stuck(planting: Planting) -> None:
    """From some moment on, the electrode repeats a usual reading."""
    first = int(planting.random.uniform(0.05, 0.6) * len(planting))
    changed = {}
    for column in planting.electrodes:
        counts = planting.counts[:, column].copy()
        counts[first:] = np.rint(counts[first - min(first, 100) : first + 1].mean())
        changed[int(column)] = counts
    planting.replace_one(changed, since=float(planting.time_s[first]))

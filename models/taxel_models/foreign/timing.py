"""Channels that come late: a slow filter, a delay, a clock that jitters, frames that get lost."""

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from taxel_models.foreign.planting import Floats, Planting

TICK_S = 0.01


def lag_first_order(planting: Planting) -> None:
    """A filter of 8 to 150 ms in every channel."""

    def late(tau: float) -> Floats:
        keep = float(np.exp(-TICK_S / tau))

        def low_pass(part: Floats) -> Floats:
            settled = keep * part[:1]
            return np.asarray(lfilter([1.0 - keep], [1.0, -keep], part, axis=0, zi=settled)[0])

        return planting.in_segments(low_pass, planting.counts)

    _nearest(planting, late, np.geomspace(0.008, 0.15, 10), "time_constant")


def lag_delay(planting: Planting) -> None:
    """5 to 100 ms, the same in every channel."""
    still = np.zeros(len(planting))
    _nearest(planting, lambda delay: _read_at(planting, still + delay), np.geomspace(0.005, 0.1, 12), "lag")


def lag_jitter(planting: Planting) -> None:
    """Rows are late by a time of their own: it is distributed exponentially up to three times its mean."""
    late = np.minimum(planting.random.exponential(1.0, len(planting)), 3.0)
    _nearest(planting, lambda mean: _read_at(planting, mean * late), np.geomspace(0.005, 0.1, 10), "lag")


def dropped_frames(planting: Planting) -> None:
    """Frames get lost in bursts, and the last one is repeated in their place."""
    length = float(planting.random.uniform(3.0, 15.0))
    order = planting.random.random(len(planting) // int(length) + 1)

    def held(share: float) -> Floats:
        lost = np.repeat(order < share, int(length))[: len(planting)]
        lost = np.concatenate([lost, np.zeros(len(planting) - len(lost), np.bool_)])
        for part in planting.recording.segments:
            lost[part.start] = False
        last = np.maximum.accumulate(np.where(lost, 0, np.arange(len(planting))))
        return planting.counts[last]

    _nearest(planting, held, np.linspace(0.05, 0.8, 10), "share")


def _nearest(planting: Planting, changed: Callable[[float], Floats], values: Floats, name: str) -> None:
    counts = planting.counts
    planting.add_nearest(((float(value), changed(float(value)) - counts) for value in values), name)


def _read_at(planting: Planting, late: Floats) -> Floats:
    """Counts (n, 21) of so many seconds (n,) before each row, within its segment."""
    read = np.empty_like(planting.counts)
    for part in planting.recording.segments:
        time = planting.time_s[part]
        for column in range(read.shape[1]):
            read[part, column] = np.interp(time - late[part], time, planting.counts[part, column])
    return read

"""Channels that come late: a slow filter, a delay, a clock that jitters, frames that get lost."""

from collections.abc import Callable

import numpy as np

from taxel_models.foreign.injection import Floats, ForeignInjection


def lag_first_order(injection: ForeignInjection) -> None:
    """A filter of 8 to 150 ms in every channel."""

    def late(tau: float) -> Floats:
        return injection.low_passed(injection.counts, tau)

    _nearest(injection, late, np.geomspace(0.008, 0.15, 10), "time_constant")


def lag_delay(injection: ForeignInjection) -> None:
    """5 to 100 ms, the same in every channel."""
    still = np.zeros(len(injection))
    _nearest(
        injection, lambda delay: _read_at(injection, still + delay), np.geomspace(0.005, 0.1, 12), "lag"
    )


def lag_jitter(injection: ForeignInjection) -> None:
    """Rows are late by a time of their own: it is distributed exponentially up to three times its mean."""
    late = np.minimum(injection.random.exponential(1.0, len(injection)), 3.0)
    _nearest(injection, lambda mean: _read_at(injection, mean * late), np.geomspace(0.005, 0.1, 10), "lag")


def dropped_frames(injection: ForeignInjection) -> None:
    """Frames get lost in bursts, and the last one is repeated in their place."""
    length = float(injection.random.uniform(3.0, 15.0))
    order = injection.random.random(len(injection) // int(length) + 1)

    def held(share: float) -> Floats:
        lost = np.repeat(order < share, int(length))[: len(injection)]
        lost = np.concatenate([lost, np.zeros(len(injection) - len(lost), np.bool_)])
        for part in injection.recording.segments:
            lost[part.start] = False
        last = np.maximum.accumulate(np.where(lost, 0, np.arange(len(injection))))
        return injection.counts[last]

    _nearest(injection, held, np.linspace(0.05, 0.8, 10), "share")


def _nearest(
    injection: ForeignInjection, changed: Callable[[float], Floats], values: Floats, name: str
) -> None:
    counts = injection.counts
    injection.add_nearest(((float(value), changed(float(value)) - counts) for value in values), name)


def _read_at(injection: ForeignInjection, late: Floats) -> Floats:
    """Counts (n, 21) of so many seconds (n,) before each row, within its segment."""
    read = np.empty_like(injection.counts)
    for part in injection.recording.segments:
        time = injection.time_s[part]
        for column in range(read.shape[1]):
            read[part, column] = np.interp(time - late[part], time, injection.counts[part, column])
    return read

"""Loose contacts: an electrode leaves for one level and comes back, again and again, while others go on.

Its landing level tells it, wherever that is: at rest, at a limit of the counts, or between.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, ELECTRODE_COLUMNS
from taxel_models.loop.basis import Floats
from taxel_models.loop.stuck_at import JUMP, StuckChannel

ELECTRODES: Final = range(*ELECTRODE_COLUMNS.indices(len(CHANNELS)))

NOISE: Final = (1, 4, 16)
"""Counts about the level that an electrode without contact may show: first a quiet converter's."""

CLEAR: Final = 4
"""A jump is larger than so many times that noise, and than `JUMP` usual steps."""

FEWEST_TIMES: Final = 6
"""So often an electrode leaves and comes back. Healthy ones of real recordings do so twice at most."""

STAYS: Final = 0.25
"""So much of a jump the prediction must be off the level meanwhile; else the electrode only rests there."""

TOGETHER: Final = 4
"""If so many channels jump in one row, the finger was touched."""

SHORTEST: Final = 6
"""Rows of an absence, 60 ms: noise about a level that a spiky channel rests at seldom lasts as long."""

SPIKE: Final = 3
"""Rows of the signal before an absence and after it: a spike is shorter."""


def loose_contacts(measured: Floats, predicted: Floats, segment: NDArray[np.int64]) -> list[StuckChannel]:
    """Electrodes that come and go although the prediction stays. Vibrations move `pac0` by jumps, too.

    Args:
        measured: (n, 21) counts.
        predicted: (n, 21) counts.
        segment: (n,) number of the segment.
    """
    starts = np.diff(segment, prepend=-1) != 0
    steps = np.abs(np.diff(measured, axis=0, prepend=measured[:1]))
    steps[starts] = 0.0
    edges = [*np.flatnonzero(starts).tolist(), len(measured)]
    usual = np.array([_usual_step(sizes) for sizes in steps.T])
    finest = np.array([_resolution(values) for values in measured.T])
    found: dict[int, StuckChannel] = {}
    for noise in NOISE:
        least = np.maximum(JUMP * usual, CLEAR * np.maximum(noise, finest))
        jumps = steps > least
        jumps &= (jumps.sum(axis=1) < TOGETHER)[:, None]
        for channel in ELECTRODES:
            if jumps[:, channel].sum() < 2 * FEWEST_TIMES:
                continue
            values, jumped = measured[:, channel], jumps[:, channel]
            level = _commonest(values[jumped], noise)
            rows, times = np.zeros(len(values), np.bool_), 0
            about, expected = values - level, predicted[:, channel] - level
            for absence, sizes in _absences(about, jumped, noise, least[channel], edges):
                if abs(expected[absence].mean()) >= STAYS * max(sizes):
                    rows[absence] = True
                    times += len(sizes) == 2
            if times >= FEWEST_TIMES:
                found.setdefault(channel, StuckChannel(channel, rows, float(level), "intermittent"))
    return [found[channel] for channel in sorted(found)]


def _usual_step(sizes: Floats) -> float:
    """The mean of a channel's steps (n,), counts, while it moves: one that sticks has few, and no jumps."""
    still = np.flatnonzero(np.diff(sizes == 0.0, prepend=False, append=False)).reshape(-1, 2)
    moves = np.ones(len(sizes), np.bool_)
    for start, stop in still:
        moves[start:stop] = stop - start < SHORTEST
    return float(sizes[moves].mean()) if moves.any() else 0.0


def _resolution(values: Floats) -> float:
    """The least step between values, counts; a coarse converter's is several counts."""
    distinct = np.unique(values)
    return float(np.diff(distinct).min()) if len(distinct) > 1 else 0.0


def _commonest(values: Floats, noise: int) -> int:
    """The level that has most values within the noise."""
    least = int(values.min())
    counts = np.bincount((values - least).astype(np.int64), minlength=2 * noise + 1)
    return least + int(np.convolve(counts, np.ones(2 * noise + 1), "same").argmax())


def _absences(
    about: Floats, jumped: NDArray[np.bool_], noise: int, jump: float, edges: list[int]
) -> Iterator[tuple[slice, list[float]]]:
    """Rows at the level that a channel jumps to or from, and the sizes of these jumps, one or two, counts.

    Args:
        about: (n,) counts over the level.
        jumped: (n,) whether the step into a row is a jump.
        noise: counts.
        jump: the least jump, counts.
        edges: the first row of each segment, and the end.
    """
    near, away = np.abs(about) <= noise, np.abs(about) > jump / 2
    for first, end in pairwise(edges):
        inside = near[first:end].astype(np.int8)
        changes = np.flatnonzero(np.diff(inside, prepend=0, append=0)) + first
        for start, stop in changes.reshape(-1, 2).tolist():
            if stop - start < SHORTEST:
                continue
            sizes = []
            if start - SPIKE >= first and jumped[start] and away[start - SPIKE : start].all():
                sizes.append(abs(float(about[start - 1])))
            if stop + SPIKE <= end and jumped[stop] and away[stop : stop + SPIKE].all():
                sizes.append(abs(float(about[stop])))
            if sizes:
                yield slice(start, stop), sizes

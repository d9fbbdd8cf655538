"""The largest change of a figure of each block over a session: a step, or a line.

The block at which it changed is the one that leaves the least squares (Page 1955); lines in the session's
time, and in what was recorded of it, are the other choices.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy import stats

from taxel_models.loop.basis import Floats

FEWEST: Final = 5
"""Blocks on each side of a change."""

OF_ONE_KIND: Final = 0.5
"""So much of a change must be there among blocks of one kind, such as a material: else the kinds differ."""


class SessionChange(NamedTuple):
    """Of a figure of each block.

    Attributes:
        first: before the step, or the line's first.
        last: after the step, or the line's last.
        since_s: when it changed; None for a line.
        before: blocks before the step, or in the line's first half.
        standard_error: of the change.
        of_kinds: whether it is one from kind to kind, such as materials that follow each other.
    """

    first: float
    last: float
    since_s: float | None
    before: int
    standard_error: float
    of_kinds: bool

    @property
    def change(self) -> float:
        """The last less the first."""
        return self.last - self.first

    @property
    def part(self) -> float:
        """The size of the change over the first."""
        return abs(self.change) / max(abs(self.first), 1e-9)

    @property
    def kept(self) -> float:
        """The last over the first, at least 0."""
        return max(self.last / max(self.first, 1e-9), 0.0)

    @property
    def t(self) -> float:
        """The change over its standard error."""
        return abs(self.change) / max(self.standard_error, 1e-9)


def largest_change(clocks: Floats, values: Floats, kinds: Sequence[Floats] = ()) -> SessionChange:
    """The step, or the line in the session's or in recorded time, that leaves least of the values.

    Args:
        clocks: (2, blocks) both times, s.
        values: (blocks,) of at least twice `FEWEST` blocks.
        kinds: the kind of each block (blocks,), by each column that names some.
    """
    count = len(values)
    places = np.arange(FEWEST, count - FEWEST + 1)
    errors = [values[:place].var() * place + values[place:].var() * (count - place) for place in places]
    # A single block that lies far from all others says how a line goes, whatever it has.
    told = [time for time in clocks if FEWEST <= (2 * time > time[0] + time[-1]).sum() <= count - FEWEST]
    lines = [(stats.linregress(time, values), time) for time in told]
    left = [((values - line.intercept - line.slope * time) ** 2).sum() for line, time in lines]
    if min(left, default=np.inf) < min(errors):
        line, time = lines[int(np.argmin(left))]
        first, last = (float(line.intercept + line.slope * end) for end in (time[0], time[-1]))
        standard_error = float(line.stderr * (time[-1] - time[0]))
        of_kinds = _is_of_kinds((time - time[0]) / (time[-1] - time[0]), last - first, values, kinds)
        return SessionChange(first, last, None, count // 2, standard_error, of_kinds)
    place = int(places[int(np.argmin(errors))])
    before, after = values[:place], values[place:]
    first, last = float(before.mean()), float(after.mean())
    standard_error = float(np.sqrt(before.var(ddof=1) / len(before) + after.var(ddof=1) / len(after)))
    of_kinds = _is_of_kinds((np.arange(count) >= place).astype(np.float64), last - first, values, kinds)
    return SessionChange(first, last, float(clocks[0, place]), place, standard_error, of_kinds)


def _is_of_kinds(share: Floats, change: float, values: Floats, kinds: Sequence[Floats]) -> bool:
    """Whether a change hardly shows among blocks of one kind.

    Args:
        share: (blocks,) of the change that is there, from 0 to 1.
        change: its size, with its sign.
        values: (blocks,) that changed.
    """
    for kind in kinds:
        _, number = np.unique(kind, return_inverse=True)
        blocks = np.bincount(number)
        if np.median(blocks) < FEWEST:
            # They number the contacts.
            continue
        inside, own = (one - (np.bincount(number, one) / blocks)[number] for one in (share, values))
        if np.sign(change) * (inside @ own) <= OF_ONE_KIND * abs(change) * (inside @ inside):
            return True
    return False

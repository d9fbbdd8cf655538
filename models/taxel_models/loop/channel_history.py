"""The history of each channel: whether its sensitivity changed over the session, and when.

A block's sensitivity is the slope of the measured counts over the predicted ones, both about their means:
what is added to a channel for longer than a block, such as by a drift, is no sensitivity. The block at
which it changed is the one that leaves the least squares (Page 1955); a line in time is the other choice.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.observations import Observations

LEAST_CHANGE: Final = 0.3
"""A smaller relative change of the sensitivity is not told."""

LEAST_T: Final = 8.0
"""The change over its standard error; the largest of some 21 channels and 100 places. Blocks are not alike:
materials that are recorded one after the other often reach 6 without any change of a channel."""

FOLLOWS: Final = 0.7
"""The least correlation of the measured and the predicted counts inside blocks: the sensitivity of a
channel that does not follow its prediction means nothing."""

WHILE_ALIVE: Final = 0.9
"""The quantile of the blocks' correlations that counts for a channel that lost sensitivity: once dead, it
follows no more. For others it is the median."""

MOST_TOLD: Final = 10.0
"""A larger factor is not told: the first sensitivity was about 0."""

CUT_OFF: Final = 0.05
"""With a larger share of its rows at a limit of the counts, a block says nothing: what is cut off has lost
its range, not its sensitivity."""

FEWEST: Final = 5
"""Blocks on each side of a change."""


@dataclass(frozen=True)
class SensitivityChange:
    """A channel whose sensitivity changed.

    Attributes:
        channel: its name.
        kept: the last sensitivity over the first.
        since_s: when it changed, s of the session; None where it changed all the time.
    """

    channel: str
    kept: float
    since_s: float | None

    def sentence(self) -> str:
        """For people."""
        size = f"{abs(1.0 - self.kept):.0%}"
        change = f"lost {size} of its sensitivity" if self.kept < 1 else f"became {size} more sensitive"
        if self.kept > MOST_TOLD:
            change = f"became more than {MOST_TOLD:.0f} times as sensitive"
        when = "over this session" if self.since_s is None else f"at {self.since_s:.0f} s"
        return f"{self.channel} {change} {when}."


def sensitivity_changes(
    observations: Observations,
    blocks: Blocks,
    explained: Floats,
    usual: Floats,
    known: NDArray[np.bool_] | None = None,
) -> Iterator[SensitivityChange]:
    """Each channel whose sensitivity changed clearly, and by more than is usual of it.

    Args:
        explained: (n, 21) what named effects other than gains add, counts.
        usual: (21,) as from `usual_changes`.
        known: (n,) rows to look at, all of them by default. On a material that the model was not trained
            on, a slope says nothing of the channel.
    """
    for channel, found, follows in _largest_changes(observations, blocks, explained, known):
        clear = found.part >= LEAST_CHANGE and found.t >= LEAST_T
        factor = max(found.kept, 1.0 / max(found.kept, 1e-9))
        quantile = WHILE_ALIVE if found.kept < 1 else 0.5
        # A sensitivity that grew was real before: a model that errs gives a small slope, too.
        real = found.kept < 1 or found.followed >= FOLLOWS
        # What goes beyond the usual factor must be a change worth telling itself.
        beyond = factor * (1.0 - LEAST_CHANGE) >= usual[channel]
        if clear and real and beyond and np.quantile(follows, quantile) >= FOLLOWS:
            yield SensitivityChange(CHANNELS[channel], found.kept, found.since_s)


def usual_changes(observations: Observations, blocks: Blocks) -> Floats:
    """(21,) the factor by which each channel's sensitivity changes, from 1 up to `MOST_TOLD`.

    Of recordings that nothing is known to be wrong with: a model errs in its own way on each material,
    and materials follow each other.
    """
    usual, nothing = np.ones(len(CHANNELS)), np.zeros_like(observations.residual)
    for channel, found, _ in _largest_changes(observations, blocks, nothing, None):
        usual[channel] = np.clip(max(found.kept, 1.0 / max(found.kept, 1e-9)), 1.0, MOST_TOLD)
    return usual


def _largest_changes(
    observations: Observations, blocks: Blocks, explained: Floats, known: NDArray[np.bool_] | None
) -> Iterator[tuple[int, "_Change", Floats]]:
    """The largest change of each channel that can be measured, and (blocks,) how well it follows."""
    of_row = blocks.of_row if known is None else np.where(known, blocks.of_row, -1)
    of_blocks = [np.flatnonzero(of_row == number) for number in range(len(blocks))]
    rows = [some for some in of_blocks if len(some)]
    if len(rows) < 2 * FEWEST:
        return
    time = np.array([observations.time_s[some].mean() for some in rows])
    order = np.argsort(time)
    signal, measured = observations.signal, observations.measured - explained
    products = np.array([_products(signal[some], measured[some]) for some in rows])[order]
    at_limit = (observations.measured <= 0) | (observations.measured >= COUNTS_MAX)
    cut_off = np.array([at_limit[some].mean(axis=0) for some in rows])[order]
    energy, cross = products[:, 0], products[:, 1]
    sizes = np.sqrt(products[:, 0] * products[:, 2])
    follows = cross / np.maximum(sizes, 1e-12)
    for channel in range(len(CHANNELS)):
        weight = energy[:, channel]
        used = (weight > 0.05 * np.median(weight)) & (cut_off[:, channel] < CUT_OFF)
        if used.sum() < 2 * FEWEST or not weight.any():
            continue
        slopes = cross[used, channel] / weight[used]
        yield channel, _change(time[order][used], slopes, follows[used, channel]), follows[:, channel]


def _products(first: Floats, second: Floats) -> Floats:
    """(3, 21) sums over rows of the first's squares, of both, and of the second's squares, about means."""
    first, second = first - first.mean(axis=0), second - second.mean(axis=0)
    return np.array([(first**2).sum(axis=0), (first * second).sum(axis=0), (second**2).sum(axis=0)])


class _Change(NamedTuple):
    """Of a channel's sensitivity.

    Attributes:
        kept: the last over the first.
        since_s: when it changed; None where it changed all the time.
        followed: how well the channel followed its prediction before, or in the first half.
        part: the size of the change over the first.
        t: the change over its standard error.
    """

    kept: float
    since_s: float | None
    followed: float
    part: float
    t: float


def _change(time: Floats, slopes: Floats, follows: Floats) -> _Change:
    """The step, or the line in time, that leaves less of the slopes."""
    count = len(slopes)
    places = np.arange(FEWEST, count - FEWEST + 1)
    errors = [slopes[:place].var() * place + slopes[place:].var() * (count - place) for place in places]
    place = int(places[int(np.argmin(errors))])
    before, after = slopes[:place], slopes[place:]
    standard_error = np.sqrt(before.var(ddof=1) / len(before) + after.var(ddof=1) / len(after))
    line = np.polyfit(time, slopes, 1)
    first, last = (float(np.polyval(line, moment)) for moment in (time[0], time[-1]))
    gradual = ((slopes - np.polyval(line, time)) ** 2).sum() < min(errors)
    if gradual:
        scatter = np.sqrt(((slopes - np.polyval(line, time)) ** 2).sum() / (count - 2))
        standard_error = scatter / (time.std() * np.sqrt(count)) * (time[-1] - time[0])
    else:
        first, last = float(before.mean()), float(after.mean())
    change = abs(last - first)
    return _Change(
        kept=max(last / max(first, 1e-9), 0.0),
        since_s=None if gradual else float(time[place]),
        followed=float(np.median(follows[: count // 2 if gradual else place])),
        part=change / max(abs(first), 1e-9),
        t=float(change / max(standard_error, 1e-9)),
    )

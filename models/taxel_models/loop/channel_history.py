"""The history of each channel: whether its sensitivity or its reading changed over the session, and when.

A block's sensitivity is the slope of the measured counts over the predicted ones, both about their means:
what is added to a channel for longer than a block, such as by a drift, is no sensitivity.

Where all contacts press alike, counts hardly move inside a block, and no slope can be had. What the channel
reads there, less its prediction, still tells that it changed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.held_out_residual import HeldOutResidual
from taxel.windows.history import TICK_S
from taxel_models.loop.basis import Floats
from taxel_models.loop.blocks import Blocks
from taxel_models.loop.observations import Observations
from taxel_models.loop.session_change import FEWEST, SessionChange, largest_change

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

LEAST_READING: Final = 2.0
"""The least change of a reading, over the error that is usual of the channel."""

PRESSED: Final = 0.3
"""A block with a smaller share of the usual signal tells nothing of the reading under load."""

MOST_CHANNELS: Final = 5
"""If the readings of more channels changed, a cause that all have did it."""


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
        size = f"{100 * abs(1.0 - self.kept):.0f} %"
        change = f"lost {size} of its sensitivity" if self.kept < 1 else f"became {size} more sensitive"
        if self.kept > MOST_TOLD:
            change = f"became more than {MOST_TOLD:.0f} times as sensitive"
        when = "over this session" if self.since_s is None else f"at {self.since_s:.0f} s"
        return f"{self.channel} {change} {when}."


@dataclass(frozen=True)
class ReadingChange:
    """A channel that reads something else than at first in the same contacts, whatever changed in it.

    Attributes:
        channel: its name.
        counts: the last difference from the prediction less the first.
        since_s: when it changed, s of the session; None where it changed all the time.
    """

    channel: str
    counts: float
    since_s: float | None

    def sentence(self) -> str:
        """For people."""
        much = f"{abs(self.counts):.0f} counts {'less' if self.counts < 0 else 'more'}"
        if self.since_s is None:
            much = f"{much} at the end of this session than at its start"
            return f"{self.channel} reads {much}, in the same contacts."
        return f"{self.channel} reads {much} from {self.since_s:.0f} s on, in the same contacts."


def changed_channels(
    observations: Observations,
    blocks: Blocks,
    explained: Floats,
    reference: HeldOutResidual | None,
    known: NDArray[np.bool_] | None = None,
) -> tuple[SensitivityChange | ReadingChange, ...]:
    """Each channel whose sensitivity changed, or else whose reading did.

    Args:
        explained: (n, 21) what named effects other than gains add, counts.
        reference: the model's own held-out residual; None if it is not known.
        known: (n,) rows to look at, all of them by default. On a material that the model was not trained
            on, neither says anything of the channel.
    """
    usual, error = np.ones(len(CHANNELS)), observations.residual.std(axis=0)
    if reference is not None:
        error = np.array(reference.std)
        if reference.sensitivity_change is not None:
            usual = np.array(reference.sensitivity_change)
    sensitivities = list(sensitivity_changes(observations, blocks, explained, usual, known))
    told = {change.channel for change in sensitivities}
    readings = [
        change
        for change in reading_changes(observations, blocks, explained, error, known)
        if change.channel not in told
    ]
    return (*sensitivities, *readings)


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
        known: as in `changed_channels`.
    """
    for channel, found, followed, follows in _largest_changes(observations, blocks, explained, known):
        clear = found.part >= LEAST_CHANGE and found.t >= LEAST_T
        factor = _factor(found)
        quantile = WHILE_ALIVE if found.kept < 1 else 0.5
        # A sensitivity that grew was real before: a model that errs gives a small slope, too.
        real = found.kept < 1 or followed >= FOLLOWS
        # What goes beyond the usual factor must be a change worth telling itself.
        beyond = factor * (1.0 - LEAST_CHANGE) >= usual[channel]
        told = clear and real and beyond and not found.of_kinds
        if told and np.quantile(follows, quantile) >= FOLLOWS:
            yield SensitivityChange(CHANNELS[channel], found.kept, found.since_s)


def reading_changes(
    observations: Observations,
    blocks: Blocks,
    explained: Floats,
    usual_error: Floats,
    known: NDArray[np.bool_] | None = None,
) -> list[ReadingChange]:
    """A few channels that read clearly something else than at first; none where it is many.

    Args:
        explained: (n, 21) what named effects other than gains add, counts.
        usual_error: (21,) standard deviation of what the model gets wrong anyway, counts.
        known: as in `changed_channels`.
    """
    rows = _rows_of_blocks(observations, blocks, known)
    if len(rows) < 2 * FEWEST:
        return []
    clocks = _clocks(observations, rows)
    left = observations.residual - explained
    kinds = _kinds(observations, rows)
    signals = np.abs([observations.signal[some].mean(axis=0) for some in rows])
    errors = np.array([left[some].mean(axis=0) for some in rows])
    found = []
    for channel, signal in enumerate(signals.T):
        used = signal > PRESSED * np.median(signal)
        if used.sum() < 2 * FEWEST:
            continue
        change = largest_change(clocks[:, used], errors[used, channel], [kind[used] for kind in kinds])
        least = max(LEAST_CHANGE * float(np.median(signal[used])), LEAST_READING * usual_error[channel])
        if abs(change.change) >= least and change.t >= LEAST_T and not change.of_kinds:
            found.append(ReadingChange(CHANNELS[channel], change.change, change.since_s))
    return found if len(found) <= MOST_CHANNELS else []


def usual_changes(observations: Observations, blocks: Blocks) -> Floats:
    """(21,) the factor by which each channel's sensitivity changes, from 1 up to `MOST_TOLD`.

    Of recordings that nothing is known to be wrong with: a model errs in its own way on each material,
    and materials follow each other.
    """
    usual, nothing = np.ones(len(CHANNELS)), np.zeros_like(observations.residual)
    for channel, found, *_ in _largest_changes(observations, blocks, nothing, None):
        usual[channel] = _factor(found)
    return usual


def _factor(found: SessionChange) -> float:
    """By how much a sensitivity changes, up or down, from 1 up to `MOST_TOLD`.

    One whose usual factor is the largest, such as a channel that hardly reads one of the materials, tells
    nothing by any change.
    """
    return min(max(found.kept, 1.0 / max(found.kept, 1e-9)), MOST_TOLD)


def _largest_changes(
    observations: Observations, blocks: Blocks, explained: Floats, known: NDArray[np.bool_] | None
) -> Iterator[tuple[int, SessionChange, float, Floats]]:
    """The largest change of each channel's sensitivity that can be measured.

    With it, how well the channel followed its prediction before, and in each block (blocks,).
    """
    rows = _rows_of_blocks(observations, blocks, known)
    if len(rows) < 2 * FEWEST:
        return
    clocks, kinds = _clocks(observations, rows), _kinds(observations, rows)
    signal, measured = observations.signal, observations.measured - explained
    products = np.array([_products(signal[some], measured[some]) for some in rows])
    at_limit = (observations.measured <= 0) | (observations.measured >= COUNTS_MAX)
    cut_off = np.array([at_limit[some].mean(axis=0) for some in rows])
    energy, cross = products[:, 0], products[:, 1]
    sizes = np.sqrt(products[:, 0] * products[:, 2])
    follows = cross / np.maximum(sizes, 1e-12)
    for channel in range(len(CHANNELS)):
        weight = energy[:, channel]
        used = (weight > 0.05 * np.median(weight)) & (cut_off[:, channel] < CUT_OFF)
        if used.sum() < 2 * FEWEST or not weight.any():
            continue
        slopes = cross[used, channel] / weight[used]
        change = largest_change(clocks[:, used], slopes, [kind[used] for kind in kinds])
        followed = float(np.median(follows[used, channel][: change.before]))
        yield channel, change, followed, follows[:, channel]


def _rows_of_blocks(
    observations: Observations, blocks: Blocks, known: NDArray[np.bool_] | None
) -> list[NDArray[np.int64]]:
    """The known rows of each block that has any, in the order of the session's time."""
    of_row = blocks.of_row if known is None else np.where(known, blocks.of_row, -1)
    of_blocks = [np.flatnonzero(of_row == number) for number in range(len(blocks))]
    return sorted(filter(len, of_blocks), key=lambda some: float(observations.time_s[some].mean()))


def _clocks(observations: Observations, rows: list[NDArray[np.int64]]) -> Floats:
    """(2, blocks) the session's time in the middle of each block, and how much was recorded by then, s."""
    counts = np.array([len(some) for some in rows])
    time = [observations.time_s[some].mean() for some in rows]
    return np.array([time, (np.cumsum(counts) - counts / 2) * TICK_S])


def _kinds(observations: Observations, rows: list[NDArray[np.int64]]) -> list[Floats]:
    """(blocks,) the kind of each block, by each column that names some."""
    firsts = [some[0] for some in rows]
    return [observations.covariates[column][firsts] for column in observations.kind_columns]


def _products(first: Floats, second: Floats) -> Floats:
    """(3, 21) sums over rows of the first's squares, of both, and of the second's squares, about means."""
    first, second = first - first.mean(axis=0), second - second.mean(axis=0)
    return np.array([(first**2).sum(axis=0), (first * second).sum(axis=0), (second**2).sum(axis=0)])

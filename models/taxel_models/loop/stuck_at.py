"""Stuck-at detection: finds channels that repeat a value, but not those that rest or saturate."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from taxel_models.loop.basis import Floats

SHORTEST_RUN: Final = 25
"""The least rows of one value, 250 ms: longer than sample and hold, shorter than a broken contact."""

BY_CHANCE: Final = 1e-3
"""A run is long if chance gives fewer than so many runs of its length in the recording."""

FAR: Final = 3.0
"""A prediction that scatters by so many times the usual residual should have moved the channel. Predictions
of a resting channel scatter less."""

MOST_PATIENCE: Final = 3.0
"""A channel that repeats a value for so many times the usual length is not only quiet."""

JUMP: Final = 4.0
"""A step of so many times the usual size is a jump: a broken channel jumps, a saturating one does not."""

ONE_SIDED: Final = 0.8
"""A channel saturates at a run's value if predictions are beyond it in at least this share of the rows."""

WHOLE: Final = 0.95
"""The share of the rows since the first run from which on a channel counts as stuck for good."""

FEWEST_DEAD: Final = 3
"""In so many runs the prediction is far from the value that a channel keeps for good: it is not cut off."""

Kind = Literal["stuck", "intermittent"]


@dataclass(frozen=True)
class StuckChannel:
    """A channel that repeats one value.

    Attributes:
        channel: its column.
        rows: (n,) where it does.
        value: the commonest of the values that it is stuck at, counts.
        kind: for good, or off and on.
    """

    channel: int
    rows: NDArray[np.bool_]
    value: float
    kind: Kind


def stuck_channels(measured: Floats, predicted: Floats, segment: NDArray[np.int64]) -> list[StuckChannel]:
    """Channels that repeat a value while it ought to change, or for longer than chance explains.

    Args:
        measured: (n, 21) counts.
        predicted: (n, 21) counts, from the model.
        segment: (n,) number of the segment: no run goes from one to another.
    """
    channels = range(measured.shape[1])
    runs = [Runs.of(measured[:, channel], segment) for channel in channels]
    usual = float(np.median([own_runs.patience for own_runs in runs]))
    still = _usual_residual(measured - predicted, predicted)
    # If noise keeps most channels from repeating a value for long, a channel that does so is broken.
    calm = np.median([own_runs.long.any() for own_runs in runs]) > 0
    found = []
    for channel, own_runs in zip(channels, runs, strict=True):
        if calm:
            broken = own_runs.suspect(predicted[:, channel], FAR * still[channel], usual)
        else:
            # A quiet channel comes to a value and leaves it by usual steps; a segment may end before that.
            open_ended = np.isnan(own_runs.steps).any(axis=0)
            broken = own_runs.long & own_runs.endless(usual).any() & (own_runs.jumps | open_ended)
        rows = np.repeat(broken, own_runs.lengths)
        if not rows.any():
            continue
        values, counts = np.unique(measured[rows, channel], return_counts=True)
        value = float(values[counts.argmax()])
        since = int(np.argmax(rows))
        stuck = rows[since:].mean() > WHOLE and (measured[since:, channel] == value).mean() > WHOLE
        found.append(StuckChannel(channel, rows, value, "stuck" if stuck else "intermittent"))
    return found


def _usual_residual(residual: Floats, predicted: Floats) -> Floats:
    """(21,) robust standard deviation, or what the other channels would have where a fault makes it."""
    own = stats.median_abs_deviation(residual, axis=0, scale="normal")
    moves = np.maximum(predicted.std(axis=0), 1e-9)
    return np.asarray(np.minimum(own, float(np.median(own / moves)) * moves))


@dataclass(frozen=True)
class Runs:
    """Stretches of one value in one channel.

    Attributes:
        starts: (runs,) first row.
        lengths: (runs,) rows.
        values: (runs,) counts.
        steps: (2, runs) counts, the step into a run and the one out of it; NaN where a segment begins
            or ends.
    """

    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]
    values: Floats
    steps: Floats

    @classmethod
    def of(cls, values: Floats, segment: NDArray[np.int64]) -> "Runs":
        """Of values (n,) in segments (n,)."""
        steps = np.abs(np.diff(values, prepend=values[:1]))
        begins = np.diff(segment, prepend=-1) != 0
        starts = np.flatnonzero((steps != 0) | begins)
        into = np.where(begins, np.nan, steps)[starts]
        edges = np.stack([into, np.append(into[1:], np.nan)])
        return cls(starts, np.diff(starts, append=len(values)), values[starts], edges)

    @cached_property
    def repeats(self) -> float:
        """How often a value is followed by itself outside long runs."""
        short = self.lengths[self.lengths < SHORTEST_RUN]
        repeats = 1.0 - len(short) / short.sum() if short.sum() > SHORTEST_RUN else 0.5
        return float(np.clip(repeats, 1e-3, 0.9999))

    @cached_property
    def long(self) -> NDArray[np.bool_]:
        """(runs,) too long for how often values repeat elsewhere in the channel."""
        return np.asarray(self.lengths >= max(SHORTEST_RUN, self._needed(-1.0 / np.log(self.repeats))))

    @cached_property
    def at_end(self) -> NDArray[np.bool_]:
        """(runs,) at the least or the greatest value of all."""
        least, greatest = self.values.min(), self.values.max()
        return np.asarray(
            ((self.values == least) | (self.values == greatest)) & (least < greatest), dtype=bool
        )

    @cached_property
    def jumps(self) -> NDArray[np.bool_]:
        """(runs,) got to or left by far more than the usual step; both, at the end of the channel's range.

        A fast press may lead to the end of the range by one large step; it does not leave it by another.
        """
        inner = np.isfinite(self.steps[0])
        usual = self.steps[0][inner].mean() if inner.any() else 1.0
        far = self.steps > JUMP * usual
        both = (far | np.isnan(self.steps)).all(axis=0)
        return np.asarray(far.any(axis=0) & (both | ~self.at_end))

    @cached_property
    def patience(self) -> float:
        """Rows: mean of what long runs last beyond the shortest, or of all by how often values repeat."""
        by_repeats = float(-1.0 / np.log(self.repeats))
        excess = self.lengths[self.long & (self.jumps | ~self.at_end)] - SHORTEST_RUN
        return max(by_repeats, float(excess.mean())) if len(excess) else by_repeats

    def endless(self, usual: float) -> NDArray[np.bool_]:
        """(runs,) longer than chance explains by how long runs last here; a broken channel sets no measure.

        Args:
            usual: patience of the other channels.
        """
        patience = float(np.clip(self.patience, usual, MOST_PATIENCE * usual))
        return np.asarray(self.lengths >= SHORTEST_RUN + self._needed(patience))

    def suspect(self, predicted: Floats, far: float, usual: float) -> NDArray[np.bool_]:
        """(runs,) long ones, if the channel jumps to those in which it did not do what it had to.

        Args:
            predicted: (n,) counts.
            far: counts; where the prediction scatters more, the channel ought to have followed.
            usual: patience of the other channels.
        """
        mean = self._mean(predicted)
        around = predicted - np.repeat(mean, self.lengths)
        lags = self.long & (np.sqrt(self._mean(around**2)) > far)
        wrong = lags | (self.long & self.endless(usual))
        # A level where the channel is cut off: reached in usual steps, and the prediction is beyond it.
        beyond = self._mean(predicted > np.repeat(self.values, self.lengths))
        one_sided = np.abs(beyond - 0.5) > ONE_SIDED - 0.5
        inside = np.isfinite(self.steps).all(axis=0)
        whole = np.isnan(self.steps).all(axis=0)
        dead = self._dead(predicted, far)
        smooth = ~self.jumps & ~dead & (self.at_end | (inside & one_sided))
        abrupt = self.jumps | dead | (~self.at_end & whole)
        by_jump, by_level = int((wrong & abrupt).sum()), int((wrong & smooth).sum())
        broken = wrong & abrupt & (by_jump > by_level)
        at_one_of = np.isin(self.values, self.values[broken & ~dead])
        return np.asarray(self.long & broken.any() & (~smooth | at_one_of))

    def _dead(self, predicted: Floats, far: float) -> NDArray[np.bool_]:
        """(runs,) at the value that the channel keeps to its end, although the prediction is elsewhere."""
        kept = np.flip(np.logical_and.accumulate(np.flip(self.values == self.values[-1]))) & self.long
        away = np.sqrt(self._mean((predicted - np.repeat(self.values, self.lengths)) ** 2)) > far
        return np.asarray(kept & ((kept & away).sum() >= FEWEST_DEAD))

    def _mean(self, rows: Floats | NDArray[np.bool_]) -> Floats:
        """(runs,) mean over each run's rows."""
        return np.asarray(np.add.reduceat(rows.astype(np.float64), self.starts) / self.lengths)

    def _needed(self, patience: float) -> float:
        """The length in rows of which chance gives fewer than `BY_CHANCE` runs."""
        return float(np.log(self.lengths.sum() / BY_CHANCE) * patience)

"""Windows of many fingertips at once, each with a clock of its own."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import InvalidArgument
from taxel.windows.combinations import PERIOD_NS, WindowSpec
from taxel.windows.extras import ExtraFeature
from taxel.windows.history import Lagged, Recursive, followed
from taxel.windows.samples import gap_of, period_of, rows_are_ticks
from taxel.windows.window_columns import position_columns

_SECONDS: Final = 6
"""The column of a tick that holds the seconds since the fingertip's first; before it: position, force."""


class FingerWindows:
    """Builds the newest window of each fingertip; the same numbers as a `WindowStream` of its own.

    Args:
        spec: what a window holds.
        fingers: how many fingertips there are.
        rate_hz: how often samples come. Near 100 Hz each sample is a tick; at any other rate
            ticks are interpolated between samples.
        extras: further columns behind the window's.
    """

    def __init__(
        self,
        spec: WindowSpec,
        fingers: int,
        *,
        rate_hz: float = 100.0,
        extras: Sequence[ExtraFeature] = (),
    ) -> None:
        if fingers < 1:
            raise InvalidArgument(f"fingers is {fingers}: expected at least 1")
        self.spec, self.fingers = spec, fingers
        self.period_ns = period_of(rate_hz)
        self._rows_are_ticks, self._gap_ns = rows_are_ticks(self.period_ns), gap_of(self.period_ns)
        self._extras = tuple(extras)
        self._needed = spec.look_back + spec.look_ahead + 1
        histories = [extra.history for extra in extras if extra.history is not None]
        lags = [history.lag for history in histories if isinstance(history, Lagged)]
        lags += [1 for history in histories if isinstance(history, Recursive)]
        # The oldest tick that is needed: a window's, or a feature's before the window's moment.
        self._depth = max(self._needed, spec.look_ahead + 1 + max(lags, default=0))
        # The ticks of a window, from its moment, and the places of its middle and of its forces among them.
        self._steps = np.arange(-spec.look_back, spec.look_ahead + 1)
        self._middle = spec.look_back - spec.shift
        self._pushes = self._middle + np.array(spec.force_steps)
        self._all = np.arange(fingers)
        self._none = np.empty((0, spec.length + len(extras)), np.float32)
        self._ticks = np.zeros((self._depth, fingers, _SECONDS + 1))
        self._features = np.zeros((self._depth, fingers, len(extras)))
        self._states = np.zeros((len(extras), fingers))
        self._count = np.zeros(fingers, np.int64)
        self._now_ns = np.zeros(fingers, np.int64)
        self._next_tick_ns = np.zeros(fingers, np.int64)
        self._first_ns = np.zeros(fingers, np.int64)
        self._started = np.zeros(fingers, np.bool_)
        self.given = [extra.name for extra in extras if extra.history is None]
        self._column_of = {name: _SECONDS + place for place, name in enumerate(self.given)}
        self._defaults = np.array([0.0] * _SECONDS + [e.default for e in extras if e.history is None])
        self._previous = np.tile(self._defaults, (fingers, 1))
        # The next sample is written here; then the two change places.
        self._spare = self._previous.copy()

    def reset(self, ids: NDArray[np.int64]) -> None:
        """Forget all samples of these fingertips, as at the start of an episode."""
        self._count[ids] = 0
        self._now_ns[ids] = 0
        self._started[ids] = False
        self._previous[ids] = self._defaults

    def prime(self, ids: NDArray[np.int64], position: NDArray[Any], force: NDArray[Any]) -> None:
        """Begin as if these fingertips had been touched so, without a change, for long.

        Args:
            ids: (m,), the fingertips.
            position: (m, 3), m.
            force: (m, 3), N.
        """
        self.reset(ids)
        sample = self._sample(self._previous[ids], position, force)
        self._first_ns[ids] = 0
        start = -self._depth * PERIOD_NS
        for tick in range(self._depth):
            times, first = np.full(len(ids), start + tick * PERIOD_NS), np.full(len(ids), not tick)
            self._tick(ids, times, sample, new=first, for_long=True)
        self._previous[ids], self._started[ids] = sample, True
        self._next_tick_ns[ids] = 0

    def _sample(
        self,
        sample: NDArray[np.float64],
        position: NDArray[Any],
        force: NDArray[Any],
        given: Mapping[str, NDArray[Any]] | None = None,
    ) -> NDArray[np.float64]:
        """Put values of any real type into samples (m, 6 + given), in place."""
        sample[:, :3], sample[:, 3:6] = position, force
        for name, values in (given or {}).items():
            sample[:, self._column_of[name]] = values
        return sample

    def step(
        self,
        position: NDArray[Any],
        force: NDArray[Any],
        dt_ns: "NDArray[np.int64] | int",
        given: Mapping[str, NDArray[Any]] | None = None,
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Take the next sample of every fingertip.

        Args:
            position: (fingers, 3), m, in each sensor's frame; of any real type, as the others.
            force: (fingers, 3), N.
            dt_ns: the time since each one's last sample, (fingers,) or one for all; of a first sample it
                does not count.
            given: values (fingers,) of extra features that have no history. A value holds until the next.

        Returns:
            The fingertips whose newest window is complete and new, (m,), and these windows, (m, f) float32.
        """
        if self.given:
            # An extra feature that is not given now keeps its value.
            self._spare[:, _SECONDS:] = self._previous[:, _SECONDS:]
        sample = self._sample(self._spare, position, force, given)
        first = ~self._started
        now, begins = self._now_ns + dt_ns, first | (dt_ns > self._gap_ns)
        if first.any():
            now[first] = self._first_ns[first] = 0
            self._started[:] = True
        if self._rows_are_ticks:
            self._tick(self._all, now, sample, new=begins)
            ready = np.flatnonzero(self._count >= self._needed)
        else:
            ready = self._tick_between(now, sample, begins)
        self._now_ns, self._previous, self._spare = now, sample, self._previous
        return ready, self._windows(ready)

    def _tick_between(
        self, now: NDArray[np.int64], sample: NDArray[np.float64], begins: NDArray[np.bool_]
    ) -> NDArray[np.int64]:
        """Take the ticks up to `now`; the fingertips that had one and whose newest window is complete."""
        self._next_tick_ns[begins] = now[begins]
        due = ticked = self._next_tick_ns <= now
        new = begins.copy()
        while due.any():
            ids = np.flatnonzero(due)
            times = self._next_tick_ns[ids]
            values = self._between(ids, times, now[ids], sample[ids], begins[ids])
            self._tick(ids, times, values, new=new[ids])
            self._next_tick_ns[ids] = times + PERIOD_NS
            new[ids] = False
            due = self._next_tick_ns <= now
        return np.flatnonzero(ticked & (self._count >= self._needed))

    def _between(
        self,
        ids: NDArray[np.int64],
        times: NDArray[np.int64],
        now: NDArray[np.int64],
        sample: NDArray[np.float64],
        begins: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        """Samples (m, 6 + given), interpolated at `times`; where a segment begins, the newest one."""
        before, since = self._previous[ids], self._now_ns[ids]
        exact = begins | (times == now)
        weight = (times - since) / np.where(exact, 1, now - since)
        return np.where(exact[:, None], sample, before + weight[:, None] * (sample - before))

    def _tick(
        self,
        ids: NDArray[np.int64],
        times: NDArray[np.int64],
        values: NDArray[np.float64],
        *,
        new: NDArray[np.bool_],
        for_long: bool = False,
    ) -> None:
        """Take a tick of some fingertips.

        Args:
            new: where it is the first of a segment.
            for_long: whether the first of a segment has been there for long.
        """
        self._count[ids[new]] = 0
        count = self._count[ids]
        tick = np.empty((len(ids), _SECONDS + 1))
        tick[:, :_SECONDS] = values[:, :_SECONDS]
        tick[:, _SECONDS] = (times - self._first_ns[ids]) / 1e9
        slot = count % self._depth
        self._ticks[slot, ids] = tick
        for column, extra in enumerate(self._extras):
            history = extra.history
            if history is None:
                self._features[slot, ids, column] = values[:, self._column_of[extra.name]]
            elif isinstance(history, Recursive):
                before = followed(history.of, self._ticks[(count - 1) % self._depth, ids])
                u = followed(history.of, tick)
                next_state = history.follow(self._states[column, ids], before, u)
                first = history.settled(u) if for_long else history.started(u)
                state = np.where(new, first, next_state)
                self._states[column, ids] = state
                self._features[slot, ids, column] = history.value(state, u)
            elif isinstance(history, Lagged):
                back = (count - np.minimum(history.lag, count)) % self._depth
                self._features[slot, ids, column] = history.value(tick, self._ticks[back, ids])
            else:
                self._features[slot, ids, column] = history.column(tick)
        self._count[ids] += 1

    def _windows(self, ids: NDArray[np.int64]) -> NDArray[np.float32]:
        if not len(ids):
            return self._none
        newest = self._count[ids] - 1 - self.spec.look_ahead
        slots = (newest + self._steps[:, None]) % self._depth
        found: NDArray[np.float64] = self._ticks[slots, ids]
        places = position_columns(self.spec, lambda step: found[self._middle + step, :, :3])
        pushes = found[self._pushes, :, 3:6].transpose(1, 0, 2).reshape(len(ids), -1)
        features = self._features[newest % self._depth, ids]
        return np.concatenate([*places, pushes, features], axis=1, dtype=np.float32, casting="same_kind")

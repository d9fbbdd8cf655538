"""Windows of a live stream, tick by tick, for one fingertip or many that share a clock."""

from collections.abc import Mapping, Sequence
from operator import index
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taxel.errors import InvalidArgument
from taxel.input_checks import InputCheck
from taxel.windows.checks import LARGEST, POSSIBLE
from taxel.windows.combinations import PERIOD_NS, WindowSpec
from taxel.windows.extras import ExtraFeature
from taxel.windows.memory import Memory
from taxel.windows.samples import gap_of, period_of, rows_are_ticks
from taxel.windows.window_columns import window_columns

_INTERVALS_CHECKED: Final = 100
"""The rate is the median of so many intervals, over and over, so that it may jitter and drop frames."""

_RATE_TOLERANCE: Final = 0.15
"""How far that median may be off: a live one is less certain than a whole recording's."""


_LATEST_NS: Final = 2**62
"""A clock has 64 bits. This is in the year 2116."""


class LiveWindow(NamedTuple):
    """The windows of all fingertips for one moment.

    Attributes:
        time_ns: the moment T that they describe, `look_ahead` ticks before the newest sample.
        values: (fingers, f) float32, ready for `Predictor.predict`.
    """

    time_ns: int
    values: NDArray[np.float32]


class WindowStream:
    """Builds windows incrementally; the same numbers as `build_windows` on the whole stream.

    Args:
        spec: what a window holds; `predictor.window` for a loaded model.
        rate_hz: how often samples come. Near 100 Hz each sample is a tick; at any other rate
            ticks are interpolated between samples.
        fingers: fingertips sampled together at each step.
        extras: further columns behind the window's; `manifest.window.extras` for a loaded model.
        check: looks at the samples, beside the contacts that a model was trained on.
    """

    def __init__(
        self,
        spec: WindowSpec,
        *,
        rate_hz: float = 100.0,
        fingers: int = 1,
        extras: Sequence[ExtraFeature] = (),
        check: InputCheck | None = None,
    ) -> None:
        if fingers < 1:
            raise InvalidArgument(f"fingers is {fingers}: expected at least 1")
        self.spec = spec
        self.fingers = fingers
        self._check = check
        period = period_of(rate_hz)
        self._rate_hz = rate_hz
        self._rows_are_ticks = rows_are_ticks(period)
        self._gap_ns = gap_of(period)
        self._depth = spec.look_back + spec.look_ahead + 1
        # Columns of a tick: 0..2 position, 3..5 force, then the extras.
        defaults = [0.0] * 6 + [extra.default for extra in extras]
        self._defaults = np.tile(np.array(defaults), (fingers, 1))
        places = {extra.name: column for column, extra in enumerate(extras, start=6)}
        computed = {extra.name: extra.history for extra in extras if extra.history is not None}
        self._given = {name: column for name, column in places.items() if name not in computed}
        self._computed = [places[name] for name in computed]
        self._memory = Memory(list(computed.values()))
        # Rings of the newest `depth` ticks.
        self._ticks = np.empty((self._depth, *self._defaults.shape))
        self._times = np.empty(self._depth, np.int64)
        self.reset()

    def reset(self) -> None:
        """Forget every sample and extra feature, as at the start of a new episode."""
        self._previous = self._defaults
        self._first_ns: int | None = None
        self._intervals: list[int] = []
        self._previous_ns: int | None = None
        self._begin_segment(0)

    def _begin_segment(self, time_ns: int) -> None:
        """Start a segment: no window reaches back across this sample."""
        self._count = 0
        self._next_tick_ns = time_ns
        self._memory.restart()

    def push(
        self,
        time_s: float,
        position: ArrayLike,
        force: ArrayLike,
        extras: Mapping[str, ArrayLike] | None = None,
    ) -> list[LiveWindow]:
        """Take one sample at `time_s` seconds; see `push_ns`."""
        try:
            time_ns = round(float(time_s) * 1e9)
        except (TypeError, ValueError, OverflowError):
            raise InvalidArgument(f"time_s is {time_s!r}: expected a finite number of seconds") from None
        return self.push_ns(time_ns, position, force, extras)

    def push_ns(
        self,
        time_ns: int,
        position: ArrayLike,
        force: ArrayLike,
        extras: Mapping[str, ArrayLike] | None = None,
    ) -> list[LiveWindow]:
        """Take one sample of every fingertip and return the windows it completes.

        Args:
            time_ns: when the sample was taken, after every earlier one. After a gap of more
                than 50 ms (or 2.5 periods, if more) the stream starts a new segment, and no window
                reaches across the gap.
            position: (3,) or (fingers, 3), m, in each sensor's own frame.
            force: likewise, N.
            extras: extra features that have no history, such as
                `{"tdc": 1960.0}`: a number, or one for each fingertip. A value holds until the next one.

        Returns:
            Usually one window. None until enough samples have come. More than one if samples come
            more slowly than ticks.

        Raises:
            InvalidArgument: a shape is wrong, a value is not finite, an extra is none or is computed,
                time does not increase, samples come at a rate that `rate_hz` does not say, or something
                looks wrong and the stream is strict.
                The stream is unchanged.
        """
        time_ns = _nanoseconds(time_ns)
        sample = self._previous.copy()
        sample[:, :3] = self._checked("position", position)
        sample[:, 3:6] = self._checked("force", force)
        for name, values in (extras or {}).items():
            sample[:, self._column_of(name)] = self._checked_extra(name, values)
        if self._check is not None:
            self._check.take(sample[:, :3], sample[:, 3:6])
            for name in extras or ():
                self._check.extra(name, sample[:, self._column_of(name)])
        self._check_time(time_ns)
        if self._previous_ns is None or time_ns - self._previous_ns > self._gap_ns:
            self._begin_segment(time_ns)
        windows = (
            self._tick(time_ns, sample) if self._rows_are_ticks else self._interpolate(time_ns, sample)
        )
        self._previous_ns, self._previous = time_ns, sample
        return windows

    def _column_of(self, name: str) -> int:
        if name not in self._given:
            known = ", ".join(self._given) or "none"
            raise InvalidArgument(f"no extra feature {name!r} is given by the caller; there is: {known}")
        return self._given[name]

    def _checked_extra(self, name: str, values: ArrayLike) -> NDArray[np.float64]:
        try:
            array = np.broadcast_to(np.asarray(values, dtype=np.float64), (self.fingers,))
        except (TypeError, ValueError):
            raise InvalidArgument(
                f"{name} is {values!r}: expected a number, or one for each of {self.fingers} fingertips"
            ) from None
        return _possible(name, array)

    def _checked(self, name: str, values: ArrayLike) -> NDArray[np.float64]:
        try:
            array = np.asarray(values, dtype=np.float64)
            # Another order of as many numbers would be taken for the places of other fingertips.
            if self.fingers == 1 and array.shape == (3,):
                array = array[None]
            if array.shape != (self.fingers, 3):
                raise ValueError(array.shape)
        except RuntimeError as error:
            # A tensor with gradients says itself what to do with it.
            raise InvalidArgument(f"{name}: {error}: expected numbers on the CPU") from None
        except (TypeError, ValueError):
            expected = "(3,)" if self.fingers == 1 else f"({self.fingers}, 3)"
            raise InvalidArgument(
                f"{name} is {np.shape(values) or values!r}: expected numbers of shape {expected}"
            ) from None
        return _possible(name, array)

    def _check_time(self, time_ns: int) -> None:
        if self._previous_ns is None:
            return
        interval = time_ns - self._previous_ns
        if interval <= 0:
            raise InvalidArgument(f"time {time_ns} ns is not after {self._previous_ns} ns before it")
        self._intervals.append(interval)
        if len(self._intervals) == _INTERVALS_CHECKED:
            median = int(np.median(self._intervals))
            self._intervals.clear()
            self._check_rate(median)

    def _check_rate(self, median_ns: int) -> None:
        """Refuse samples that `build_windows` would treat differently."""
        if self._rows_are_ticks:
            wrong = abs(median_ns - PERIOD_NS) > _RATE_TOLERANCE * PERIOD_NS
        else:
            wrong = median_ns > self._gap_ns
        if wrong:
            raise InvalidArgument(
                f"samples come every {median_ns / 1e6:g} ms but the stream was made for "
                f"{self._rate_hz:g} Hz: make it with rate_hz={1e9 / median_ns:g}"
            )

    def _interpolate(self, time_ns: int, sample: NDArray[np.float64]) -> list[LiveWindow]:
        windows: list[LiveWindow] = []
        while self._next_tick_ns <= time_ns:
            tick_ns = self._next_tick_ns
            if tick_ns == time_ns or self._previous_ns is None:
                values = sample
            else:
                weight = (tick_ns - self._previous_ns) / (time_ns - self._previous_ns)
                values = self._previous + weight * (sample - self._previous)
            windows += self._tick(tick_ns, values)
            self._next_tick_ns += PERIOD_NS
        return windows

    def _tick(self, time_ns: int, values: NDArray[np.float64]) -> list[LiveWindow]:
        slot = self._count % self._depth
        self._ticks[slot] = values
        if self._computed:
            seconds = np.full(self.fingers, self._seconds(time_ns))
            tick = np.column_stack([values[:, :6], seconds])
            self._ticks[slot][:, self._computed] = self._memory.step(tick)
        self._times[slot] = time_ns
        self._count += 1
        if self._count < self._depth:
            return []
        columns = window_columns(
            self.spec, lambda step: self._around(step)[:, :3], lambda step: self._around(step)[:, 3:6]
        )
        slot = self._slot(0)
        columns.append(self._ticks[slot][:, 6:])
        moment = int(self._times[slot])
        return [LiveWindow(moment, np.concatenate(columns, axis=1).astype(np.float32))]

    def _seconds(self, time_ns: int) -> float:
        """Since the stream's first tick."""
        if self._first_ns is None:
            self._first_ns = time_ns
        return (time_ns - self._first_ns) / 1e9

    def _around(self, step: int) -> NDArray[np.float64]:
        """The tick `step` ticks after the middle of the window, (fingers, 6 + extras)."""
        tick: NDArray[np.float64] = self._ticks[self._slot(step - self.spec.shift)]
        return tick

    def _slot(self, step: int) -> int:
        """Where the ring holds the tick `step` ticks after T."""
        return (self._count - 1 - self.spec.look_ahead + step) % self._depth


def _nanoseconds(time_ns: int) -> int:
    """A time of any whole type as Python's, whose differences have a sign."""
    try:
        whole = index(time_ns)
    except TypeError:
        raise InvalidArgument(f"time_ns is {time_ns!r}: expected whole nanoseconds") from None
    if abs(whole) > _LATEST_NS:
        raise InvalidArgument(f"time_ns is {whole}: expected at most {_LATEST_NS}; `push` takes seconds")
    return whole


def _possible(name: str, array: NDArray[np.float64]) -> NDArray[np.float64]:
    if not (np.abs(array) <= LARGEST).all():
        raise InvalidArgument(f"{name} is {array.tolist()}: expected {POSSIBLE}")
    return array

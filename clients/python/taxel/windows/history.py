"""History features: what a model may know of the past in addition to its window.

Features start settled, as if the first sample of the segment had always been there, so a stream may begin
anywhere; a relaxation may start from rest instead. A feature restarts at a gap; only `Elapsed` continues.

A tick is a row of seven values: position, m, force, N, and seconds since the recording's first tick.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from math import expm1
from typing import Annotated, ClassVar, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from typing_extensions import override

from taxel.schema import NotNegative, Positive, Schema
from taxel.windows.combinations import PERIOD_NS
from taxel.windows.samples import Samples

TICK_S: Final = PERIOD_NS / 1e9
SHARE_FORCE_N: Final = 0.5
"""Keeps `RelaxationShare` finite where there is no force."""

TOUCH_N: Final = 0.1
"""Less force than this counts as free air: ten times the force sensor's noise of the published rig."""

Followed = Literal["fx", "fy", "fz", "force"]
"""What a history feature follows: a component of the force, or its magnitude; N."""

Starts = Literal["settled", "rest"]
"""How a feature begins: as if the segment's first u had been there for long, or as if u came just then."""


def followed(which: Followed, ticks: NDArray[np.float64]) -> NDArray[np.float64]:
    """The followed values of ticks (n, 7), (n,) N."""
    x, y, z = ticks[:, 3], ticks[:, 4], ticks[:, 5]
    if which == "force":
        magnitude: NDArray[np.float64] = np.sqrt(x * x + y * y + z * z)
        return magnitude
    return {"fx": x, "fy": y, "fz": z}[which]


Rule = Callable[[float, float, Iterable[float]], list[float]]
"""From y, u before, and u of the ticks that follow, to y of these ticks."""


class Recursive(Schema, ABC):
    """A feature with a state y that follows u, starting at the segment's first u.

    The u of the tick before is called `before`; at the first tick it is u itself.

    Attributes:
        of: the signal u.
    """

    of: Followed

    def settled(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """The y after u has stayed the same for long, element by element."""
        return u

    def started(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """The y at a segment's first u, element by element."""
        return self.settled(u)

    @abstractmethod
    def rule(self) -> Rule:
        """The recursion over some ticks of a segment, in plain floats."""

    @abstractmethod
    def follow(
        self, y: NDArray[np.float64], before: NDArray[np.float64], u: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """`rule` over one tick, for arrays, element by element; the same bits."""

    @abstractmethod
    def value(self, y: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        """The feature, element by element."""

    def column(self, ticks: NDArray[np.float64]) -> NDArray[np.float64]:
        """The feature, (n,), at each tick (n, 7) of one segment."""
        u = followed(self.of, ticks)
        signal, y = u.tolist(), self.started(u[:1]).tolist()
        if len(signal) > 1:
            y += self.rule()(y[0], signal[0], signal[1:])
        return self.value(np.array(y, np.float64), u)


class Lagged(Schema, ABC):
    """A feature of a tick and the tick `lag` ticks before it, or the segment's first if that is nearer."""

    lag: ClassVar[int]

    @abstractmethod
    def value(self, now: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
        """The feature, (n,), of ticks (n, 7) and those before them."""

    def column(self, ticks: NDArray[np.float64]) -> NDArray[np.float64]:
        """The feature, (n,), at each tick (n, 7) of one segment."""
        return self.value(ticks, ticks[np.maximum(np.arange(len(ticks)) - self.lag, 0)])


class _Relaxing(Recursive):
    """A first-order low-pass y: at each tick, y += (1 - exp(-10 ms / time_constant_s)) (u - y)."""

    time_constant_s: Positive

    @override
    def rule(self) -> Rule:
        step = -expm1(-TICK_S / self.time_constant_s)
        return lambda y, _, signal: [y := y + step * (u - y) for u in signal]

    @override
    def follow(
        self, y: NDArray[np.float64], before: NDArray[np.float64], u: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        return y + -expm1(-TICK_S / self.time_constant_s) * (u - y)


class Relaxation(_Relaxing):
    """The part of a first-order response to u that is still to come: y - u.

    Attributes:
        starts: `settled`, y at the segment's first u; or from `rest`, y at 0, as if it were touched then.
        whole: y itself, in place of y - u.
    """

    kind: Literal["relaxation"] = "relaxation"
    starts: Starts = "settled"
    whole: bool = False

    @override
    def started(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.settled(u) if self.starts == "settled" else np.zeros_like(u)

    @override
    def value(self, y: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        return y if self.whole else y - u


class RelaxationShare(_Relaxing):
    """`Relaxation` as a share of the load: (y - u) / (|u| + 0.5 N)."""

    kind: Literal["relaxation_share"] = "relaxation_share"

    @override
    def value(self, y: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        return (y - u) / (np.abs(u) + SHARE_FORCE_N)


class Play(Recursive):
    """The play operator (backlash): H - u, with H = min(max(H, u - w), u + w).

    It tells loading from unloading, at any speed: -w after u rose, +w after it fell.
    """

    kind: Literal["play"] = "play"
    width_n: Positive

    @override
    def rule(self) -> Rule:
        width = self.width_n
        # `min` and `max` take six times as long.
        return lambda y, _, signal: [
            y := u - width if y < u - width else u + width if y > u + width else y for u in signal
        ]

    @override
    def follow(
        self, y: NDArray[np.float64], before: NDArray[np.float64], u: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        return np.minimum(np.maximum(y, u - self.width_n), u + self.width_n)

    @override
    def value(self, y: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        return y - u


class Friction(Recursive):
    """The friction of Dahl's model (1968): y - u, from -w where u rose long to +w where it fell.

    Over a step du, h = y - u becomes (h - du) / (1 + |du| / w): Dahl's dh = -du - |du| h / w, solved
    implicitly. It turns gradually after a reversal, and small movements to and fro let it fade, which
    `Play` does not.
    """

    kind: Literal["friction"] = "friction"
    width_n: Positive

    @override
    def rule(self) -> Rule:
        width = self.width_n

        def states(y: float, before: float, signal: Iterable[float]) -> list[float]:
            found = []
            for u in signal:
                y = u + (y - u) / (1.0 + abs(u - before) / width)
                before = u
                found.append(y)
            return found

        return states

    @override
    def follow(
        self, y: NDArray[np.float64], before: NDArray[np.float64], u: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        return u + (y - u) / (1.0 + np.abs(u - before) / self.width_n)

    @override
    def value(self, y: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        return y - u


class Warmth(Recursive):
    """How warm contact has made the fingertip: it goes to 1 while u is above 0.1 N, else to 0.

    Newton's law of cooling, with a time constant for each of the two: what is touched takes heat at
    another rate than air does.

    Attributes:
        starts: `settled`, as if the segment's first u had been there for long; or from `rest`, at 0.
    """

    kind: Literal["warmth"] = "warmth"
    warming_s: Positive
    cooling_s: Positive
    starts: Starts = "settled"

    @override
    def settled(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        return (u > TOUCH_N).astype(np.float64)

    @override
    def started(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.settled(u) if self.starts == "settled" else np.zeros_like(u)

    @override
    def rule(self) -> Rule:
        warming, cooling = -expm1(-TICK_S / self.warming_s), -expm1(-TICK_S / self.cooling_s)
        return lambda y, _, signal: [
            y := y + warming * (1.0 - y) if u > TOUCH_N else y - cooling * y for u in signal
        ]

    @override
    def follow(
        self, y: NDArray[np.float64], before: NDArray[np.float64], u: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        warming, cooling = -expm1(-TICK_S / self.warming_s), -expm1(-TICK_S / self.cooling_s)
        return np.where(u > TOUCH_N, y + warming * (1.0 - y), y - cooling * y)

    @override
    def value(self, y: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        return y


class Load(Lagged):
    """u itself, N."""

    kind: Literal["load"] = "load"
    of: Followed
    lag: ClassVar[int] = 0

    @override
    def value(self, now: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
        return followed(self.of, now)


class LoadAbove(Lagged):
    """What of u lies above a level, max(u - above_n, 0), N: the skin meets the core there."""

    kind: Literal["load_above"] = "load_above"
    of: Followed
    above_n: Positive
    lag: ClassVar[int] = 0

    @override
    def value(self, now: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.maximum(followed(self.of, now) - self.above_n, 0.0)


class _Changing(Lagged):
    of: Followed
    lag: ClassVar[int] = 3

    def rate(self, now: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
        """(u[T] - u[T-3]) / 30 ms, N/s."""
        return (followed(self.of, now) - followed(self.of, before)) / (self.lag * TICK_S)


class Rate(_Changing):
    """How fast u changes: (u[T] - u[T-3]) / 30 ms, N/s."""

    kind: Literal["rate"] = "rate"

    @override
    def value(self, now: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.rate(now, before)


class BoundedRate(_Changing):
    """`Rate` that saturates: r / (half + |r|), between -1 and 1; it is 1/2 where r is `half_n_s`."""

    kind: Literal["bounded_rate"] = "bounded_rate"
    half_n_s: Positive

    @override
    def value(self, now: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
        rate = self.rate(now, before)
        bounded: NDArray[np.float64] = rate / (self.half_n_s + np.abs(rate))
        return bounded


class Direction(_Changing):
    """Whether u rises or falls, weighted by its size: tanh(rate / (1 N/s)) |u|, N."""

    kind: Literal["direction"] = "direction"

    @override
    def value(self, now: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.tanh(self.rate(now, before)) * np.abs(followed(self.of, now))


class Speed(Lagged):
    """How fast the contact moves: |position[T] - position[T-10]| / 100 ms, m/s."""

    kind: Literal["speed"] = "speed"
    lag: ClassVar[int] = 10

    @override
    def value(self, now: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y, z = (now[:, axis] - before[:, axis] for axis in range(3))
        speed: NDArray[np.float64] = np.sqrt(x * x + y * y + z * z) / (self.lag * TICK_S)
        return speed


class Elapsed(Schema):
    """Time since the first sample of a recording or stream, within limits: clip(t, start, end) - start, s.

    A gap does not restart it. It stays constant after `end_s`, so a model never extrapolates.
    """

    kind: Literal["elapsed"] = "elapsed"
    start_s: NotNegative
    end_s: Positive

    @model_validator(mode="after")
    def _ends_after_it_starts(self) -> Self:
        if self.end_s <= self.start_s:
            raise ValueError(f"end_s {self.end_s}: expected more than start_s {self.start_s}")
        return self

    def column(self, ticks: NDArray[np.float64]) -> NDArray[np.float64]:
        """The feature, (n,), at each tick (n, 7)."""
        return np.clip(ticks[:, 6], self.start_s, self.end_s) - self.start_s


HistoryFeature = Annotated[
    Relaxation
    | RelaxationShare
    | Play
    | Friction
    | Warmth
    | Load
    | LoadAbove
    | Rate
    | BoundedRate
    | Direction
    | Speed
    | Elapsed,
    Field(discriminator="kind"),
]
"""Any of the features; `kind` says which."""


def history_columns(samples: Samples, features: Sequence[HistoryFeature]) -> NDArray[np.float64]:
    """History features at every tick of a recording: the same numbers as in a live stream.

    Args:
        samples: resampled to 10 ms ticks first if they are not ticks.
        features: in column order.

    Returns:
        (ticks, m).
    """
    samples = samples.ticks()
    seconds = (samples.time_ns - samples.time_ns[:1]) / 1e9
    ticks = np.column_stack([samples.position, samples.force, seconds])
    columns = np.empty((len(ticks), len(features)))
    for segment in samples.segments:
        for column, feature in enumerate(features):
            columns[segment, column] = feature.column(ticks[segment])
    return columns

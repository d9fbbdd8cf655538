"""The indenter's motion: contact cycles of random place, force, shear and pace.

A cycle travels above the skin, approaches, presses, holds or slides, releases, stays in a light
touch below 0.3 N, and retreats. All figures here are assumptions. They are chosen so that the contacts
are like the paper's: one contact at a time, forces up to about 10 N and mostly below 5 N, light touches at
the end of each cycle, and places that cover the whole skin unevenly.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.skin import Patch, patch
from taxel_models.twin.lag import PERIOD_S, lagged

PHASES_S: Final = {
    "travel": (0.5, 1.5),
    "approach": (0.2, 0.5),
    "press": (0.25, 1.0),
    "hold": (0.4, 2.0),
    "release": (0.25, 0.8),
    "linger": (0.15, 0.4),
    "retreat": (0.2, 0.5),
}
"""Least and greatest length of each phase."""

PEAK_N: Final = (2.0, 0.7, 0.4, 8.0)
"""Peak force: median, SD of its logarithm, least, greatest."""

LIGHT_TOUCH_N: Final = (0.08, 0.28)
CLEARANCE_MM: Final = (8.0, 25.0)
HOLD_DRIFT: Final = (0.6, 1.2)
TREMOR: Final = 0.08
TREMOR_S: Final = 0.25
"""Changes of a held force: a drift of its level and a relative tremor (SD)."""

FRICTION: Final = (0.2, 0.6)
STICK_SHEAR: Final = 0.4
SLIDING_SHARE: Final = 0.5
SLIDE_MM: Final = 3.5
"""Half of the contacts slide some millimetres (SD) and drag the skin; the others shear at random."""

ALONG_MM: Final = (-14.0, 10.0)
AROUND_RAD: Final = (0.8, 2.0)
TIP_SHARE: Final = 0.3
TIP_MM: Final = (4.0, 2.5)
"""Places: three in ten around the tip (mean, SD), others evenly along; around the axis (SD, limit)."""


@dataclass(frozen=True)
class Contacts:
    """The indenter over n rows.

    Attributes:
        places: where on the skin it is, or above where.
        clearance: (n,), how far above the skin its tip is; 0 in contact, mm.
        press: (n,), normal force, N.
        shear: (n, 3), tangential force on the skin, N, in the sensor's frame.
        rubbing: (n,), square root of sliding speed (mm/s) times normal force (N).
        cycle: (n,), number of the contact cycle.
    """

    places: Patch
    clearance: NDArray[np.float64]
    press: NDArray[np.float64]
    shear: NDArray[np.float64]
    rubbing: NDArray[np.float64]
    cycle: NDArray[np.int64]

    def uneven(self, sd: float, dice: np.random.Generator) -> NDArray[np.float64]:
        """A factor (n,) about 1 with this SD, one figure for each contact cycle."""
        factors = 1.0 + sd * dice.standard_normal(int(self.cycle.max()) + 1)
        return np.asarray(factors[self.cycle])


@dataclass(frozen=True)
class _Pace:
    """When each phase of each cycle ends: `knots` (7 cycles + 1,) s, from 0, for rows at `time` (n,) s."""

    cycles: int
    knots: NDArray[np.float64]
    time: NDArray[np.float64]

    @classmethod
    def draw(cls, rows: int, dice: np.random.Generator) -> "_Pace":
        shortest = sum(least for least, _ in PHASES_S.values())
        cycles = int(rows * PERIOD_S / shortest) + 1
        lengths = np.column_stack([dice.uniform(*limits, cycles) for limits in PHASES_S.values()])
        time = PERIOD_S * np.arange(rows, dtype=np.float64)
        return cls(cycles, np.append(0.0, lengths.cumsum()), time)

    @property
    def phase(self) -> NDArray[np.int64]:
        """The number of each row's phase, counted over all cycles."""
        return np.searchsorted(self.knots, self.time, side="right") - 1

    def follow(self, *at_ends: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """A smooth course (n,) that stops at each phase's end at these values, (cycles,) each."""
        table = np.column_stack([np.broadcast_to(value, self.cycles) for value in at_ends])
        values = np.append(table[0, -1], table)
        share = (self.time - self.knots[self.phase]) / np.diff(self.knots)[self.phase]
        eased = share * share * (3.0 - 2.0 * share)
        return np.asarray(values[self.phase] + eased * np.diff(values)[self.phase])


def contacts(rows: int, radius: float, dice: np.random.Generator) -> Contacts:
    """As many contact cycles as fill `rows` rows of 10 ms on a skin of `radius` mm."""
    pace = _Pace.draw(rows, dice)
    places, way = _places(pace, radius, dice)
    above = dice.uniform(*CLEARANCE_MM, (2, pace.cycles))
    clearance = pace.follow(above[0], 0, 0, 0, 0, 0, above[1])
    press = _press(pace, dice)
    forward, sideways = (pace.follow(0, 0, ratio, ratio, 0, 0, 0) for ratio in _shear_ratio(way, dice))
    shear = press[:, None] * (forward[:, None] * places.forward + sideways[:, None] * places.sideways)
    steps = np.diff(places.point, axis=0, prepend=places.point[:1])
    speed = np.linalg.norm(steps, axis=1) / PERIOD_S
    return Contacts(places, clearance, press, shear, np.sqrt(speed * press), pace.phase // len(PHASES_S))


def _places(pace: _Pace, radius: float, dice: np.random.Generator) -> tuple[Patch, NDArray[np.float64]]:
    """Where the indenter is over time, and how far each cycle slides, forward and sideways: (2, cycles)."""
    cycles = pace.cycles
    near_tip = dice.random(cycles) < TIP_SHARE
    along = np.where(near_tip, dice.normal(*TIP_MM, cycles), dice.uniform(*ALONG_MM, cycles))
    sd, limit = AROUND_RAD
    around = dice.normal(0.0, sd, cycles)
    slides = dice.random(cycles) < SLIDING_SHARE
    way = np.where(slides, dice.normal(0.0, SLIDE_MM, (2, cycles)), 0.0)
    start, end = np.clip(np.stack([along, along + way[0]]), *ALONG_MM)
    turn, turned = np.clip(np.stack([around, around + way[1] / radius]), -limit, limit)
    along_rows = pace.follow(start, start, start, end, end, end, end)
    around_rows = pace.follow(turn, turn, turn, turned, turned, turned, turned)
    return patch(along_rows, around_rows, radius), way


def _press(pace: _Pace, dice: np.random.Generator) -> NDArray[np.float64]:
    """The normal force (n,), N."""
    median, sd, least, greatest = PEAK_N
    peak = np.clip(median * np.exp(sd * dice.standard_normal(pace.cycles)), least, greatest)
    held = np.minimum(peak * dice.uniform(*HOLD_DRIFT, pace.cycles), greatest)
    light = dice.uniform(*LIGHT_TOUCH_N, pace.cycles)
    return np.asarray(
        pace.follow(0, 0, peak, held, light, 0, 0)
        * np.maximum(1.0 + TREMOR * tremor(len(pace.time), dice), 0.0)
    )


def tremor(rows: int, dice: np.random.Generator) -> NDArray[np.float64]:
    """Slow, smooth random noise (rows,) with an SD of about 1."""
    white = dice.standard_normal(rows) * np.sqrt(4.0 * TREMOR_S / PERIOD_S)
    return lagged(lagged(np.append(0.0, white), TREMOR_S), TREMOR_S)[1:]


def _shear_ratio(way: NDArray[np.float64], dice: np.random.Generator) -> NDArray[np.float64]:
    """Shear over normal force, forward and sideways, (2, cycles): along the slide, or at random."""
    length = np.hypot(*way)
    slides = length > 0.0
    friction = dice.uniform(*FRICTION, len(slides))
    angle = dice.uniform(0.0, 2.0 * np.pi, len(slides))
    stuck = dice.uniform(0.0, STICK_SHEAR, len(slides)) * np.stack([np.cos(angle), np.sin(angle)])
    return np.where(slides, friction * way / np.where(slides, length, 1.0), stuck)

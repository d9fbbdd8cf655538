"""The course of a recording protocol: where the indenter is at each row, and when the finger is on."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.skin import patch
from taxel_models.twin.contacts import AROUND_RAD, TREMOR, Contacts, tremor
from taxel_models.twin.lag import PERIOD_S
from taxel_models.twin.protocol import (
    APPROACH_S,
    TRAVEL_S,
    Column,
    Pause,
    Press,
    RecordingProtocol,
    SwitchOff,
    Turn,
    WarmUp,
)

CLEARANCE_MM: Final = 10.0
"""How far above the skin the indenter moves."""


@dataclass(frozen=True)
class Course:
    """A protocol row by row.

    Attributes:
        contacts: over n + 1 rows.
        time_s: (n + 1,) since the first row; it jumps where nothing is recorded.
        stretches: the rows of each stretch without such a gap.
        gaps: before each stretch but the first: how long the finger is on, or off, s, in order.
        columns: further columns (n,) by name.
    """

    contacts: Contacts
    time_s: NDArray[np.float64]
    stretches: tuple[slice, ...]
    gaps: tuple[tuple[tuple[bool, float], ...], ...]
    columns: dict[str, NDArray[np.float64]]

    @property
    def rows(self) -> int:
        """n, that are recorded."""
        return len(self.time_s) - 1


@dataclass
class _Knots:
    """Ends of movements: when, and clearance, force, shear forward and sideways, along, around there."""

    at_s: list[float] = field(default_factory=lambda: [0.0])
    values: list[tuple[float, ...]] = field(default_factory=list)
    number: list[int] = field(default_factory=lambda: [0])
    """Of the press that each movement belongs to."""

    def move(self, seconds: float, *values: float, press: int) -> None:
        if seconds > 0:
            self.at_s.append(self.at_s[-1] + seconds)
            self.values.append(values)
            self.number.append(press)

    @property
    def here(self) -> tuple[float, ...]:
        return self.values[-1]


def course_of(protocol: RecordingProtocol, radius: float, dice: np.random.Generator) -> Course:
    """The course of a protocol on a skin of `radius` mm; held forces tremble at random."""
    knots, turned, presses = _Knots(), 0.0, 0
    first = next((step.place for step in protocol.all_steps() if isinstance(step, Press)), None)
    along = 0.0 if first is None else first.along_mm
    around = 0.0 if first is None else _around(first.around_deg)
    knots.values.append((CLEARANCE_MM, 0.0, 0.0, 0.0, along, around))
    gaps: list[tuple[float, list[tuple[bool, float]]]] = []
    columns: dict[str, list[tuple[float, float]]] = {}
    for step in protocol.all_steps():
        match step:
            case Turn():
                turned += step.degrees
            case Column():
                columns.setdefault(step.column, []).append((knots.at_s[-1], step.value))
            case Pause():
                knots.move(step.seconds, *knots.here, press=presses)
            case WarmUp() | SwitchOff():
                if not gaps or gaps[-1][0] < knots.at_s[-1]:
                    gaps.append((knots.at_s[-1], []))
                gaps[-1][1].append((isinstance(step, WarmUp), step.seconds))
            case Press():
                presses += 1
                _press(knots, step, turned, presses)
    rows = max(1, round(knots.at_s[-1] / PERIOD_S))
    running = PERIOD_S * np.arange(rows + 1, dtype=np.float64)
    # What comes before the first row, or after the last, opens no gap.
    inside = [(at, parts) for at, parts in gaps if 0.0 < at < running[-1]]
    starts = [0, *(int(np.searchsorted(running, at - 1e-9)) for at, _ in inside)]
    time = running.copy()
    for start, (_, parts) in zip(starts[1:], inside, strict=True):
        time[start:] += sum(seconds for _, seconds in parts)
    return Course(
        _contacts(knots, running, radius, dice),
        time,
        tuple(slice(start, stop) for start, stop in zip(starts, [*starts[1:], rows + 1], strict=True)),
        tuple(tuple(parts) for _, parts in inside),
        {name: _column(changes, running[:rows]) for name, changes in columns.items()},
    )


def _press(knots: _Knots, step: Press, turned: float, number: int) -> None:
    place = (step.place.along_mm, _around(step.place.around_deg + turned))
    force, shear = step.force_n, step.shear
    load_s = force / step.speed_n_s
    knots.move(TRAVEL_S, CLEARANCE_MM, 0.0, *shear, *place, press=number)
    knots.move(APPROACH_S, 0.0, 0.0, *shear, *place, press=number)
    knots.move(load_s, 0.0, force, *shear, *place, press=number)
    knots.move(step.hold_s, 0.0, force, *shear, *place, press=number)
    knots.move(load_s, 0.0, 0.0, *shear, *place, press=number)
    knots.move(APPROACH_S, CLEARANCE_MM, 0.0, *shear, *place, press=number)


def _around(degrees: float) -> float:
    """Radians, within the skin's limits."""
    return float(np.clip(np.radians(degrees), -AROUND_RAD[1], AROUND_RAD[1]))


def _contacts(
    knots: _Knots, time: NDArray[np.float64], radius: float, dice: np.random.Generator
) -> Contacts:
    at_s, table = np.array(knots.at_s), np.array(knots.values)
    after = np.clip(np.searchsorted(at_s, time, side="right"), 1, len(at_s) - 1)
    share = np.clip((time - at_s[after - 1]) / np.diff(at_s)[after - 1], 0.0, 1.0)
    eased = share * share * (3.0 - 2.0 * share)
    values = table[after - 1] + eased[:, None] * (table[after] - table[after - 1])
    clearance, force, forward, sideways, along, around = values.T
    press = force * np.maximum(1.0 + TREMOR * tremor(len(time), dice), 0.0)
    places = patch(along, around, radius)
    shear = press[:, None] * (forward[:, None] * places.forward + sideways[:, None] * places.sideways)
    return Contacts(places, clearance, press, shear, np.zeros(len(time)), np.array(knots.number)[after])


def _column(changes: list[tuple[float, float]], time: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) the value at each row; before the first change it is the first value."""
    at_s, values = np.array(changes).T
    last = np.clip(np.searchsorted(at_s, time + 1e-9, side="right") - 1, 0, len(values) - 1)
    return np.asarray(values[last])

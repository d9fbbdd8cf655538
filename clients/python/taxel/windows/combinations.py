"""The paper's eight input combinations: which samples around time T make a window."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal

from taxel.errors import InvalidArgument

PERIOD_NS: Final = 10_000_000
"""One tick: windows are built from samples 10 ms apart."""

REACH: Final = 10
"""The longest step of any combination, ticks; the 'last' and 'next' position look as far."""

MOST_SHIFT: Final = 100
"""Largest shift of a window, ticks."""

Position = Literal["now", "last", "next"]

_SPARSE = (0, -10, 10)
_DENSE = tuple(range(-10, 11))

_FORCE_STEPS: Final[dict[int, tuple[int, ...]]] = {
    1: _SPARSE,
    2: (0, -10),
    3: (0,),
    4: (0, -10, -5, 5, 10),
    5: _DENSE,
    6: tuple(range(-10, 1)),
    7: _SPARSE,
    8: _DENSE,
}
COMBINATIONS: Final = tuple(_FORCE_STEPS)
_WITH_NEIGHBOURS: Final = frozenset({7, 8})


@dataclass(frozen=True)
class WindowSpec:
    """What one window holds: positions (m), then forces (N), in the sensor's frame.

    `WindowSpec.of(combination)` is the usual way to get one.

    Attributes:
        positions: which positions, relative to the middle of the window.
        force_steps: ticks from the middle of the window.
        shift: ticks from the middle of the window to T; 0 unless the channels follow the contact late.
    """

    combination: int
    positions: tuple[Position, ...]
    force_steps: tuple[int, ...]
    shift: int = 0

    @classmethod
    def of(cls, combination: int, shift: int = 0) -> "WindowSpec":
        """The window of input combination 1..8, built around T or `shift` ticks before it.

        Raises:
            InvalidArgument: there is no such combination, or the shift is more than `MOST_SHIFT`.
        """
        if combination not in _FORCE_STEPS:
            raise InvalidArgument(f"input combination {combination!r}: expected one of 1 to 8")
        neighbours: tuple[Position, ...] = ("last", "next") if combination in _WITH_NEIGHBOURS else ()
        if abs(shift) > MOST_SHIFT:
            raise InvalidArgument(f"shift {shift!r}: expected at most {MOST_SHIFT} ticks")
        return cls(combination, ("now", *neighbours), _FORCE_STEPS[combination], shift)

    @cached_property
    def features(self) -> tuple[str, ...]:
        """Names in column order, such as `x`, `x[last]`, `fx`, `fx[-10]`, `fx[+10]`.

        They count from T: shifted by 3 ticks these are `x[-3]`, `x[last-3]`, `fx[-3]`, `fx[-13]`, `fx[+7]`.
        """
        positions = tuple(
            axis + (_step(-self.shift) if which == "now" else f"[{which}{_signed(-self.shift)}]")
            for which in self.positions
            for axis in ("x", "y", "z")
        )
        forces = tuple(
            axis + _step(step - self.shift) for step in self.force_steps for axis in ("fx", "fy", "fz")
        )
        return positions + forces

    @cached_property
    def unshifted(self) -> "WindowSpec":
        """The same window without a shift, as the model knows it."""
        return replace(self, shift=0)

    @cached_property
    def length(self) -> int:
        """Values in one window."""
        return 3 * (len(self.positions) + len(self.force_steps))

    @cached_property
    def look_back(self) -> int:
        """Ticks before T that a window needs."""
        reach = max(REACH if "last" in self.positions else 0, -min(self.force_steps))
        return max(reach + self.shift, 0)

    @cached_property
    def look_ahead(self) -> int:
        """Ticks after T that a window needs. A live answer comes later by as much."""
        reach = max(REACH if "next" in self.positions else 0, max(self.force_steps))
        return max(reach - self.shift, 0)

    @property
    def delay_s(self) -> float:
        """Delay of a live answer after the moment that it describes, s; 0 if causal."""
        return self.look_ahead * PERIOD_NS / 1e9

    @property
    def warm_up_s(self) -> float:
        """Time from a stream's first sample to its first answer, s; with a primed past, `delay_s`."""
        return (self.look_back + self.look_ahead) * PERIOD_NS / 1e9


def _step(step: int) -> str:
    return f"[{step:+d}]" if step else ""


def _signed(step: int) -> str:
    return f"{step:+d}" if step else ""

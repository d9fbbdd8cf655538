"""The paper's eight input combinations: which samples around time T make a window."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

from taxel.errors import InvalidArgument

PERIOD_NS: Final = 10_000_000
"""One tick: windows are built from samples 10 ms apart."""

REACH: Final = 10
"""Ticks that 'last' and 'next' position search, and the longest step of any combination."""

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
    """

    combination: int
    positions: tuple[Position, ...]
    force_steps: tuple[int, ...]

    @classmethod
    def of(cls, combination: int) -> "WindowSpec":
        """The window of input combination 1..8.

        Raises:
            InvalidArgument: there is no such combination.
        """
        if combination not in _FORCE_STEPS:
            raise InvalidArgument(f"input combination {combination!r}: expected one of 1 to 8")
        neighbours: tuple[Position, ...] = ("last", "next") if combination in _WITH_NEIGHBOURS else ()
        return cls(combination, ("now", *neighbours), _FORCE_STEPS[combination])

    @cached_property
    def features(self) -> tuple[str, ...]:
        """Names in column order, such as `x`, `x[last]`, `fx`, `fx[-10]`, `fx[+10]`."""
        positions = tuple(
            axis if which == "now" else f"{axis}[{which}]"
            for which in self.positions
            for axis in ("x", "y", "z")
        )
        forces = tuple(
            axis if step == 0 else f"{axis}[{step:+d}]"
            for step in self.force_steps
            for axis in ("fx", "fy", "fz")
        )
        return positions + forces

    @cached_property
    def length(self) -> int:
        """Values in one window."""
        return 3 * (len(self.positions) + len(self.force_steps))

    @cached_property
    def look_back(self) -> int:
        """Ticks before T that a window needs."""
        return max(REACH if "last" in self.positions else 0, -min(self.force_steps))

    @cached_property
    def look_ahead(self) -> int:
        """Ticks after T that a window needs: online, its answer comes that much later."""
        return max(REACH if "next" in self.positions else 0, max(self.force_steps))

    @property
    def delay_s(self) -> float:
        """Seconds by which an online answer trails the moment it describes; 0 if causal."""
        return self.look_ahead * PERIOD_NS / 1e9

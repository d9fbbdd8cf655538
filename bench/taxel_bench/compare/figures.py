"""What one server takes for one window, for many at once and for a large query; and ratios."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from statistics import median
from typing import Self


@dataclass(frozen=True)
class Figures:
    """Of one server.

    Attributes:
        sequential_p50_ms: of a query of one window, one after the other.
        sequential_cpu_us: processor time of the server for each of these.
        in_flight_per_s: queries of one window, with many in flight.
        in_flight_cpu_us: processor time of the server for each of these.
        bulk_p50_ms: of a query of many windows.
    """

    sequential_p50_ms: float
    sequential_cpu_us: float
    in_flight_per_s: float
    in_flight_cpu_us: float
    bulk_p50_ms: float

    @classmethod
    def median(cls, several: Sequence[Self]) -> Self:
        """The median of each figure."""
        return cls(*(median(getattr(figures, field.name) for figures in several) for field in fields(cls)))

    def over(self, other: "Figures") -> dict[str, float]:
        """Each figure as a multiple of another server's."""
        others = asdict(other)
        return {name: value / others[name] for name, value in asdict(self).items()}


def median_ratios(ours: Sequence[Figures], theirs: Sequence[Figures]) -> dict[str, float]:
    """The median over rounds of our figures as multiples of theirs in the same round."""
    rounds = [mine.over(other) for mine, other in zip(ours, theirs, strict=True)]
    return {field.name: median(ratios[field.name] for ratios in rounds) for field in fields(Figures)}

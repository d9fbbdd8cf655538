"""What one server takes for one window, for many at once and for large queries; and ratios."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any, Self


@dataclass(frozen=True)
class Gap:
    """Queries of one window, one after the other, with a pause between an answer and the next query.

    Attributes:
        p50_ms: of a query's latency.
        p99_ms: of a query's latency.
        cpu_us: processor time of the server for each query.
    """

    p50_ms: float
    p99_ms: float
    cpu_us: float


@dataclass(frozen=True)
class Figures:
    """Of one server.

    Attributes:
        sequential_p50_ms: of a query of one window, one after the other.
        sequential_cpu_us: processor time of the server for each of these.
        in_flight_per_s: queries of one window, with many in flight.
        in_flight_cpu_us: processor time of the server for each of these.
        bulk_p50_ms: of a query of many windows.
        batch_p50_ms: of a query of some windows.
        gaps: by the pause, in milliseconds.
    """

    sequential_p50_ms: float
    sequential_cpu_us: float
    in_flight_per_s: float
    in_flight_cpu_us: float
    bulk_p50_ms: float
    batch_p50_ms: float
    gaps: Mapping[str, Gap] = field(default_factory=dict)

    @classmethod
    def median(cls, several: Sequence[Self]) -> Self:
        """The median of each figure."""
        medians = _medians([asdict(figures) for figures in several])
        gaps = {gap: Gap(**figures) for gap, figures in medians.pop("gaps").items()}
        return cls(**medians, gaps=gaps)

    def over(self, other: "Figures") -> dict[str, Any]:
        """Each figure as a multiple of another server's."""
        return _ratios(asdict(self), asdict(other))


def median_ratios(ours: Sequence[Figures], theirs: Sequence[Figures]) -> dict[str, Any]:
    """The median over rounds of our figures as multiples of theirs in the same round."""
    return _medians([mine.over(other) for mine, other in zip(ours, theirs, strict=True)])


def _ratios(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: _ratios(value, theirs[name]) if isinstance(value, Mapping) else value / theirs[name]
        for name, value in ours.items()
    }


def _medians(several: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The median of each number in mappings of the same shape."""
    return {
        name: _medians([each[name] for each in several])
        if isinstance(value, Mapping)
        else median(each[name] for each in several)
        for name, value in several[0].items()
    }

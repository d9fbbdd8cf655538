"""What `bench lane` prints for people."""

from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.table import Table

from taxel_bench.lane.measurement import Latency
from taxel_bench.lane.stages import STAGES


def print_lane(
    console: Console,
    latencies: Mapping[str, Mapping[str, Latency]],
    stages: Mapping[str, Sequence[float]],
) -> None:
    """Latency by pause, then the stages of a query, one column for each pause."""
    table = Table("pause ms", "way", "p50 µs", "p99 µs")
    for gap, ways in latencies.items():
        for way, latency in ways.items():
            table.add_row(gap, way, f"{latency.p50_us:.1f}", f"{latency.p99_us:.1f}")
    console.print(table)
    table = Table("stage, median µs", *(f"{gap} ms" for gap in stages))
    for name, *taken in zip(STAGES, *stages.values(), strict=True):
        table.add_row(name, *(f"{each:.1f}" for each in taken))
    table.add_row("sum", *(f"{sum(each):.1f}" for each in stages.values()))
    console.print(table)

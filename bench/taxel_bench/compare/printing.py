"""A comparison for the terminal."""

from rich.console import Console
from rich.table import Table

from taxel_bench.compare.comparison import Comparison
from taxel_bench.compare.rounds import AT_ONCE, BATCH_ROWS, BULK_ROWS

_COLUMNS = (
    ("sequential_p50_ms", "one window\np50 ms", "{:.3f}"),
    ("sequential_cpu_us", "\nserver CPU µs", "{:.0f}"),
    ("in_flight_per_s", f"{AT_ONCE} in flight\nqueries/s", "{:,.0f}"),
    ("in_flight_cpu_us", "\nserver CPU µs", "{:.0f}"),
    ("batch_p50_ms", f"{BATCH_ROWS} windows\np50 ms", "{:.3f}"),
    ("bulk_p50_ms", f"{BULK_ROWS} windows\np50 ms", "{:.2f}"),
)


def print_comparison(console: Console, comparison: Comparison) -> None:
    """Medians of every server, then Taxel's figures as multiples of the others', then who is missing."""
    bare = comparison.bare()
    medians = _table("server")
    medians.add_row(
        "bare runtime call", f"{bare.one_p50_ms:.3f}", "", "", "", "", f"{bare.bulk_p50_ms:.2f}"
    )
    for name, figures in comparison.figures().items():
        medians.add_row(name, *(form.format(getattr(figures, field)) for field, _, form in _COLUMNS))
    console.print(medians)
    if ratios := comparison.ratios():
        table = _table("as a multiple of")
        for (ours, name), ratio in ratios.items():
            table.add_row(f"{ours} / {name}", *(f"{ratio[field]:.2f}" for field, _, _ in _COLUMNS))
        console.print(table)
    _print_gaps(console, comparison)
    for name, reason in comparison.skipped.items():
        console.print(f"skipped {name}: {reason}", markup=False, soft_wrap=True)


def _print_gaps(console: Console, comparison: Comparison) -> None:
    """Latency with pauses between queries, as a control loop asks."""
    table = Table("server", "pause ms", "p50 ms", "p99 ms", "server CPU µs")
    for name, figures in comparison.figures().items():
        for pause, gap in figures.gaps.items():
            table.add_row(name, pause, f"{gap.p50_ms:.3f}", f"{gap.p99_ms:.3f}", f"{gap.cpu_us:.0f}")
    if table.row_count:
        console.print(table)


def _table(first: str) -> Table:
    table = Table(first)
    for _, title, _ in _COLUMNS:
        table.add_column(title, justify="right")
    return table

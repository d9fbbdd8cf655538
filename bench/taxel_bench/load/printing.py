"""A run's figures for the terminal."""

from rich.console import Console
from rich.table import Table

from taxel_bench.load.results import PERCENTILES, Percentiles, Results
from taxel_bench.load.settings import LoadSettings


def print_results(out: Console, settings: LoadSettings, label: str, results: Results) -> None:
    """Print what was sent, the verdict, the times and the usage.

    Args:
        label: of the model that answered, as NAME/VERSION.
    """
    out.print(f"[bold]{settings.scenario}[/], {label}, {_described(settings)}: ", end="")
    out.print(results.verdict, style="bold green" if results.verdict == "VALID" else "bold red")
    for reason in results.reasons:
        out.print(f"  {reason}", markup=False, soft_wrap=True)
    out.print(_times(results))
    failed = results.sent - results.answered
    lines = [
        f"{results.sent:,} sent = {results.answered:,} answered + {failed:,} errors",
        f"{results.queries_per_s:,.0f} queries/s, {results.samples_per_s:,.0f} samples/s "
        f"in {results.seconds:.2f} s",
        f"{results.batches['count']:,} batches, by rows: {_histogram(results.batch_rows)}",
        f"CPU a query: {_cpu(results.server_cpu_us)} server, {_cpu(results.clients_cpu_us)} clients",
    ]
    for line in lines:
        out.print(line, soft_wrap=True)


def _described(settings: LoadSettings) -> str:
    parts = [f"{settings.clients} client{'s' * (settings.clients > 1)}"]
    parts.append(f"{settings.samples_per_query} sample{'s' * (settings.samples_per_query > 1)} a query")
    if settings.server != "taxel":
        parts.append(settings.server)
    if settings.gap_ms:
        parts.append(f"pauses of {settings.gap_ms:g} ms")
    if settings.rate_qps is not None:
        parts.append(f"{settings.rate_qps:g} queries/s")
    return ", ".join(parts)


def _times(results: Results) -> Table:
    table = Table("ms", *(f"p{share:g}" for share in PERCENTILES), "max")
    for column in table.columns[1:]:
        column.justify = "right"
    table.add_row("latency", *_cells(results.latency_ms))
    if results.late_ms is not None:
        table.add_row("of that sent late", *_cells(results.late_ms))
    table.add_row("of that in the queue", *_cells(results.queue_ms))
    table.add_row("of that computing", *_cells(results.compute_ms))
    return table


def _cells(figures: Percentiles) -> list[str]:
    return ["-" if value is None else f"{value:.3f}" for value in figures.values()]


def _histogram(buckets: dict[str, int]) -> str:
    """Counts by `1`, `2`, `3-4`, `5-8` and so on."""
    parts = []
    for end, count in sorted((int(end), count) for end, count in buckets.items()):
        first = end // 2 + 1
        parts.append(f"{first}-{end}: {count:,}" if first < end else f"{end}: {count:,}")
    return ", ".join(parts) or "none"


def _cpu(microseconds: float | None) -> str:
    return "unknown" if microseconds is None else f"{microseconds:,.0f} µs"

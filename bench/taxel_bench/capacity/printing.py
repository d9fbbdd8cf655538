"""The tables of `bench capacity`."""

from collections.abc import Sequence
from typing import Any

from rich.table import Table


def capacity_table(results: Sequence[dict[str, Any]]) -> Table:
    """A row for each model, transport and rate."""
    table = Table("model", "over", "Hz", "fingers", "p99 ms", "server, cores", "verdict")
    for each in results:
        table.add_row(
            each["model"],
            each["transport"],
            f"{each['rate_hz']:g}",
            f"{each['fingers']:,}",
            _number(each["p99_ms"], 2),
            _number(each["server_cpu"], 2),
            each["verdict"],
        )
    return table


def service_table(services: Sequence[dict[str, Any]]) -> Table:
    """What a request and a window cost the server, µs."""
    table = Table("model", "over", "a request, µs", "a window, µs", "the way, µs")
    for each in services:
        times = (f"{each[name] * 1e6:,.1f}" for name in ("request_s", "row_s", "way_s"))
        table.add_row(each["model"], each["transport"], *times)
    return table


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"

"""`taxel top`: what a running server does, in a terminal that is drawn again and again."""

import sys
import time
from collections.abc import Mapping
from typing import Annotated, Any, Final

import typer
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from taxel.commands.cli import OUT, Json, print_json
from taxel.errors import Internal
from taxel.protocol import unpackb
from taxel.remote import RemoteSource, connect

_MOST_REFUSALS: Final = 8


def top(
    endpoint: Annotated[str, typer.Argument(help="A running server, as tcp/HOST:PORT.")],
    every: Annotated[float, typer.Option(min=0.1, max=3600, help="Seconds between two looks.")] = 1.0,
    once: Annotated[
        bool, typer.Option("--once", help="Look twice, print the difference, and end.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Show requests, rows, errors, times and memory of a server, live. Ctrl-C ends it.

    Times are those of the last interval, as the upper ends of buckets that double. Without a terminal, or
    with --json, it looks once.
    """
    with connect(endpoint) as source:
        before, at = read_statistics(source), time.monotonic()
        if once or as_json or not sys.stdout.isatty():
            time.sleep(every)
            told = compared(before, read_statistics(source), time.monotonic() - at)
            if as_json:
                print_json(told)
            else:
                OUT.print(_drawn(endpoint, told))
            return
        with Live(console=OUT, auto_refresh=False, screen=True) as live:
            while True:
                time.sleep(every)
                now, then = read_statistics(source), time.monotonic()
                live.update(_drawn(endpoint, compared(before, now, then - at)), refresh=True)
                before, at = now, then


def read_statistics(source: RemoteSource) -> dict[str, Any]:
    """A server's statistics since its start.

    Raises:
        RequestError: it does not answer, or is too old to tell them.
    """
    told = unpackb(source.get(f"{source.prefix}/v2/stats"))
    if not isinstance(told, dict) or "models" not in told:
        raise Internal(f"{source.endpoint}: the answer to v2/stats is malformed")
    return told


def compared(before: Mapping[str, Any], now: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """What happened between two looks: rates per second, percentiles, and what is now."""
    earlier = {(model["name"], model["version"]): model for model in before["models"]}
    models = []
    for model in now["models"]:
        was = earlier.get((model["name"], model["version"]), {})
        models.append(
            {
                "model": f"{model['name']}/{model['version']}",
                "requests_per_s": (model["requests"] - was.get("requests", 0)) / seconds,
                "rows_per_s": (model["rows"] - was.get("rows", 0)) / seconds,
                "errors_per_s": (sum(model["errors"].values()) - sum(was.get("errors", {}).values()))
                / seconds,
                "cancelled_per_s": (_cancelled(model) - _cancelled(was)) / seconds,
                **{
                    f"{field}_{name}": _percentile(was.get(field, {}), model[field], share)
                    for field in ("queue_us", "compute_us")
                    for name, share in (("p50", 0.5), ("p99", 0.99))
                },
                "batch_rows_p50": _percentile(was.get("batch_rows", {}), model["batch_rows"], 0.5),
            }
        )
    shadows = [
        {"model": f"{model['name']}/{model['version']}", **model["shadow"]}
        for model in now["models"]
        if "shadow" in model
    ]
    kept = ("uptime_s", "queue", "connections", "refusals", "loads", "resident_bytes")
    return {
        "seconds": seconds,
        **{name: now[name] for name in kept},
        "waited_for_core": waited_for_core(before, now, seconds),
        "models": models,
        "shadows": shadows,
    }


def _cancelled(model: Mapping[str, Any]) -> int:
    """Requests that were dropped because nobody waited for them; older servers do not tell."""
    count: int = model.get("cancelled", {}).get("requests", 0)
    return count


def waited_for_core(before: Mapping[str, Any], now: Mapping[str, Any], seconds: float) -> float | None:
    """The share of the time for which the server waited for a processor; None if it does not tell."""
    then, delay = before.get("run_delay_s"), now.get("run_delay_s")
    return None if then is None or delay is None else (delay - then) / seconds


def _percentile(before: Mapping[str, Any], now: Mapping[str, Any], share: float) -> int | None:
    """The upper end of the bucket that a share of the new values lies below; None if there is none."""
    earlier = before.get("buckets", {})
    new = sorted((int(end), count - earlier.get(end, 0)) for end, count in now["buckets"].items())
    wanted = share * sum(count for _, count in new)
    for end, count in new:
        wanted -= count
        if count and wanted <= 0:
            return end
    return None


def _drawn(endpoint: str, told: Mapping[str, Any]) -> Group:
    connections = ", ".join(f"{count} {name}" for name, count in told["connections"].items())
    head = Text(
        f"{endpoint}   up {told['uptime_s']:,.0f} s   {told['resident_bytes'] / 2**20:,.0f} MiB   "
        f"clients: {connections or 'none'}   queue: {told['queue']['requests']} requests, "
        f"{told['queue']['rows']} rows"
    )
    waited = told["waited_for_core"]
    if waited is not None:
        head.append(f"   waited for a core: {waited:.0%} of the time")
    table = Table(
        caption="cncl: given up by clients; wait, eval: µs in the queue and in the evaluation; "
        "batch: rows evaluated together"
    )
    table.add_column("model", no_wrap=True)
    for heading in ("req/s", "rows/s", "err/s", "cncl/s", "wait p50", "p99", "eval p50", "p99", "batch"):
        table.add_column(heading, justify="right")
    for model in told["models"]:
        name, *values = model.values()
        shown = ["" if value is None else f"{value:,.0f}" for value in values]
        table.add_row(Text(name), *shown)
    refusals = sorted(told["refusals"], key=lambda each: -each[2])[:_MOST_REFUSALS]
    lines = [Text(f"{count:>10,} {code} to {client}") for code, client, count in refusals]
    shadows = [
        Text(
            f"{shadow['model']}, a shadow of {shadow['of']}: "
            + ", ".join(f"{count:,} {what}" for what, count in shadow["rows"].items())
            + f"; it differs by {shadow['mean_difference']:.3g} counts in the mean, by at most "
            f"{shadow['max_difference']:.3g}, most in {shadow['channel'] or 'none'}"
        )
        for shadow in told["shadows"]
    ]
    return Group(head, table, *shadows, *([Text("errors since the start:"), *lines] if lines else []))

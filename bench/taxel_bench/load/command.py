"""`bench load`: a running server under load from client processes, in MLPerf's scenarios."""

import signal
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel_bench.load.settings import TIMEOUT_S, LoadSettings, Scenario, Server
from taxel_bench.options import Gaps, parse_gaps


@needs("bench", "psutil")
def load(
    scenario: Annotated[Scenario, typer.Option(help="How queries follow each other.")],
    model: Annotated[str, typer.Option(help="The name of a served model.")],
    clients: Annotated[int, typer.Option(min=1, help="Client processes.")] = 1,
    samples_per_query: Annotated[
        int | None,
        typer.Option(min=1, show_default="by scenario: 1, 8, 1, 1024", help="Windows in a query."),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(min=0.001, show_default="500", help="Queries a second over all clients: server."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(min=0.1, show_default="10", help="Seconds of sending.")
    ] = None,
    queries: Annotated[
        int | None,
        typer.Option(min=1, show_default="offline: 96", help="Send so many in all, for however long."),
    ] = None,
    latency_bound: Annotated[
        float | None, typer.Option(min=0, help="INVALID where the scenario's percentile is above it, ms.")
    ] = None,
    timeout: Annotated[float, typer.Option(min=0.1, help="Seconds to wait for an answer.")] = TIMEOUT_S,
    server: Annotated[
        Server, typer.Option(help="Ask over zenoh, or in streams over the server's lane.")
    ] = "taxel",
    gap_ms: Gaps = "0",
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="A running server; without it, one is started.")
    ] = None,
    repository: Annotated[
        Path | None,
        typer.Option(help="What a server that is started serves; the shipped models if not set."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the arrivals and the windows.")] = 0,
    as_json: Json = False,
) -> None:
    """Drive a server from client processes: latency, throughput and CPU in MLPerf's scenarios."""
    from taxel_bench.load.drive import drive, server_at
    from taxel_bench.load.printing import print_results
    from taxel_bench.load.results import Results
    from taxel_bench.machine import describe_machine
    from taxel_bench.server_process import ROOM
    from taxel_models.shipped import shipped_repository

    gaps = parse_gaps(gap_ms)
    settings = LoadSettings.of(
        scenario,
        model,
        clients=clients,
        samples_per_query=samples_per_query,
        queries=queries,
        duration_s=duration,
        rate_qps=rate,
        latency_bound_ms=latency_bound,
        timeout_s=timeout,
        seed=seed,
        server=server,
        gap_ms=max(gaps),
    )
    # Told to stop, it still stops its server and clients.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    # Offline, a client sends everything at once: more than its share of the queue by default.
    served = repository or shipped_repository()
    with shown("measuring"), server_at(connect, served, *ROOM) as endpoint:
        runs = [replace(settings, gap_ms=gap) for gap in gaps]
        outcomes = [drive(run, endpoint) for run in runs]
    several = [Results.of(run, outcome) for run, outcome in zip(runs, outcomes, strict=True)]
    results, manifest = several[0], outcomes[0].manifest
    machine = describe_machine()
    if as_json:
        told = {"version": manifest.version, "inputs": manifest.window.combination}
        print_json(
            {
                "machine": machine,
                "scenario": asdict(runs[0]) | told,
                "results": asdict(results),
                "gaps": {f"{gap:g}": each.of_gap() for gap, each in zip(gaps, several, strict=True)},
            }
        )
        return
    for run, each in zip(runs, several, strict=True):
        print_results(OUT, run, manifest.label, each)
    OUT.print(f"on {machine['cpu']}, {machine['cores']} cores, load {machine['load']}", soft_wrap=True)

"""`bench scale`: how many replicas a fleet needs."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING
from taxel.errors import SettingsError
from taxel.remote.options import Transport
from taxel_bench.scale.queueing import Arrivals, Balancing

if TYPE_CHECKING:
    from taxel_bench.capacity.service_time import ServiceTime


@needs("bench", *SERVING, "psutil")
def scale(
    fingers: Annotated[int, typer.Option(min=1, help="Of the whole fleet.")],
    rate: Annotated[float, typer.Option(min=0.1, max=20_000, help="Steps a second.")] = 100.0,
    model: Annotated[str, typer.Option(help="The name of a served model.")] = "xgb",
    windows: Annotated[int, typer.Option(min=1, max=65_536, help="Fingers that one client asks for.")] = 1,
    transport: Annotated[Transport, typer.Option(help="How clients ask.")] = "zenoh",
    latency_bound: Annotated[
        float | None, typer.Option(min=0.001, show_default="one step", help="What p99 stays below, ms.")
    ] = None,
    measured: Annotated[
        Path | None,
        typer.Option(help="What `bench capacity --json` printed; without it, service times are measured."),
    ] = None,
    arrivals: Annotated[
        Arrivals, typer.Option(help="At random, or at a fixed moment of a step.")
    ] = "poisson",
    balancing: Annotated[
        Balancing, typer.Option("--spread", help="A replica for each client, or the less busy of two.")
    ] = "fixed",
    requests: Annotated[int, typer.Option(min=10_000, help="That are simulated.")] = 200_000,
    seed: Annotated[int, typer.Option(min=0, help="Of arrivals and choices.")] = 0,
    as_json: Json = False,
) -> None:
    """Say how many servers a fleet needs: a queueing simulation with measured service times."""
    from rich.table import Table

    from taxel_bench.scale.plan import Fleet, plan

    if windows > fingers:
        raise SettingsError(f"--windows {windows}: more than the {fingers} fingers of the fleet")
    bound_ms = latency_bound or 1e3 / rate
    fleet = Fleet(fingers, windows, rate)
    service = _read(measured, model, transport) if measured is not None else _measure(model, transport)
    with shown("simulating"):
        tried = plan(
            fleet, service, bound_ms, arrivals=arrivals, balancing=balancing, requests=requests, seed=seed
        )
    told: dict[str, Any] = {
        **asdict(fleet),
        "model": model,
        "transport": transport,
        "latency_bound_ms": bound_ms,
        "arrivals": arrivals,
        "spread": balancing,
        "seed": seed,
        "service": service._asdict(),
        "replicas": tried[-1].replicas,
        "tried": [asdict(each) for each in tried],
    }
    if as_json:
        print_json(told)
        return
    table = Table("replicas", "busy", "p50 ms", "p99 ms")
    for each in tried:
        table.add_row(
            str(each.replicas), f"{each.utilisation:.0%}", f"{each.p50_ms:.2f}", f"{each.p99_ms:.2f}"
        )
    OUT.print(table)
    OUT.print(
        f"{fleet.clients:,} clients of {windows} fingers at {rate:g} Hz, {model} over {transport}, "
        f"{service.of(windows) * 1e6:,.0f} µs a request: {tried[-1].replicas} replicas "
        f"keep p99 below {bound_ms:g} ms",
        soft_wrap=True,
    )


def _measure(model: str, transport: Transport) -> "ServiceTime":
    from taxel_bench.capacity.command import generator
    from taxel_bench.capacity.service_time import measure_service_time
    from taxel_models.shipped import shipped_repository

    with shown("measuring"), generator(shipped_repository(), 1, 2.0) as asking:
        return measure_service_time(asking, model, transport, 2.0)


def _read(path: Path, model: str, transport: Transport) -> "ServiceTime":
    """The service time of a model, of a file that `bench capacity --json` printed.

    Raises:
        SettingsError: the file is something else, or does not have it.
    """
    from taxel_bench.capacity.service_time import ServiceTime

    try:
        services = json.loads(path.read_text(encoding="utf-8"))["service"]
        found = {
            (each["model"], each["transport"]): ServiceTime(each["request_s"], each["row_s"], each["way_s"])
            for each in services
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SettingsError(
            f"--measured {path}: {error}: expected what `bench capacity --json` printed"
        ) from None
    if (model, transport) not in found:
        there = ", ".join(f"{name} over {way}" for name, way in found)
        raise SettingsError(f"--measured {path}: no {model} over {transport}; there is: {there}")
    return found[model, transport]

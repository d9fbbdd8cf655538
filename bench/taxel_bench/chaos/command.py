"""`bench chaos`: faults against a live server, with a verdict for each figure."""

import signal
import sys
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown

Fault = Literal["flood", "oversize", "mutated", "clients", "stopped", "full-disk"]

_ALL: Final[tuple[Fault, ...]] = get_args(Fault)


@needs("bench", "psutil")
def chaos(
    only: Annotated[Fault | None, typer.Option(help="Only this.")] = None,
    model: Annotated[str, typer.Option(help="The name of a served model.")] = "xgb",
    rows: Annotated[str, typer.Option(help="Windows of a request in a flood, separated by commas.")] = (
        "1,64,1024,16384"
    ),
    flooders: Annotated[
        str,
        typer.Option(help="Who floods: Taxel's client (taxel), or one that sends everything (zenoh)."),
    ] = "taxel,zenoh",
    seconds: Annotated[float, typer.Option(min=1, help="How long each part of a flood lasts.")] = 5.0,
    payloads: Annotated[int, typer.Option(min=1, help="Mutated requests over each transport.")] = 10_000,
    seed: Annotated[int, typer.Option(min=0, help="Of the mutations.")] = 0,
    connect: Annotated[
        str | None,
        typer.Option(metavar="ENDPOINT", help="A server on this machine; if none, one is started."),
    ] = None,
    arrivals: Annotated[
        bool,
        typer.Option("--arrivals", help="Count refusals from their arrival, in a server that notes it."),
    ] = False,
    repository: Annotated[
        Path | None,
        typer.Option(help="What a server that is started serves; the shipped models if not set."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Flood a server, send it bad requests, be a bad client: a table of figures, each VALID or INVALID."""
    from taxel.errors import SettingsError, TaxelError
    from taxel_bench.chaos.arrivals import Refused, noting_server
    from taxel_bench.chaos.bars import Bar
    from taxel_bench.chaos.flood import bars_of_floods, client_processes, floods_of, oversize_of
    from taxel_bench.chaos.flooders import FLOODERS
    from taxel_bench.chaos.hostile import (
        bars_of_full_disk,
        full_disk_of,
        hostile_of,
    )
    from taxel_bench.chaos.printing import bars_table, verdict_of_bars
    from taxel_bench.load.drive import server_at
    from taxel_bench.load.usage import listening_process
    from taxel_bench.machine import describe_machine
    from taxel_bench.options import parse_names
    from taxel_models.shipped import shipped_repository

    if arrivals and (only != "flood" or connect is not None):
        raise SettingsError(
            "--arrivals: a server is started for it; expected --only flood, and no --connect"
        )
    faults = [only] if only else _ALL
    who = parse_names("--flooders", flooders, FLOODERS, "flooder")
    # Told to stop, it still stops its server and clients.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    served = repository or shipped_repository()
    results: dict[str, Any] = {}
    bars: list[Bar] = []
    refused: list[Refused] = []
    start = noting_server(served, refused) if arrivals else server_at(connect, served)
    with shown("asking") as tell, start as endpoint:
        server = listening_process(endpoint)
        if server is None:
            raise TaxelError(
                f"{endpoint}: no process of this machine that this user may look at listens there"
            )
        if "flood" in faults or "oversize" in faults:
            with client_processes(endpoint) as pool:
                if "flood" in faults:
                    sizes = [int(size) for size in rows.split(",")]
                    results["flood"] = floods_of(pool, server, model, sizes, seconds, who)
                if "oversize" in faults:
                    results["oversize"] = held = oversize_of(pool, server, model)
                    more_mib = held["peak_mib"] - held["calm_mib"]
                    bars.append(Bar("400 MiB in one message: more MiB held", more_mib, 50))
        told, more = hostile_of(faults, endpoint, server, model, payloads, seed, tell)
        results |= told
        bars += more
        bars.append(Bar("servers that have ended", float(not server.is_running()), 0))
    bars = bars_of_floods(results.get("flood", []), refused if arrivals else None) + bars
    if "full-disk" in faults:
        results["full-disk"] = full_disk_of(served, model, seed)
        bars += bars_of_full_disk(results["full-disk"])
    verdict = verdict_of_bars(bars)
    if as_json:
        about = {"machine": describe_machine(), "model": model, "seconds": seconds}
        print_json({**about, **results, "bars": [bar.as_dict() for bar in bars], "verdict": verdict})
        return
    OUT.print(bars_table(bars))
    OUT.print(verdict)

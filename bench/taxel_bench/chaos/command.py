"""`bench chaos`: faults against a live server, with a verdict for each figure."""

import signal
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from taxel.commands.cli import ERR, OUT, Json, needs, print_json

Fault = Literal["flood", "oversize"]


@needs("bench", "psutil")
def chaos(
    only: Annotated[Fault | None, typer.Option(help="Only this.")] = None,
    model: Annotated[str, typer.Option(help="The name of a served model.")] = "xgb",
    rows: Annotated[str, typer.Option(help="Windows of a request in a flood, separated by commas.")] = (
        "1,64,1024,16384"
    ),
    seconds: Annotated[float, typer.Option(min=1, help="How long each part of a flood lasts.")] = 5.0,
    connect: Annotated[
        str | None,
        typer.Option(metavar="ENDPOINT", help="A server on this machine; if none, one is started."),
    ] = None,
    repository: Annotated[
        Path | None,
        typer.Option(help="What a server that is started serves; the shipped models if not set."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Flood a server and send it what is too large: a table of figures, each VALID or INVALID."""
    from rich.table import Table

    from taxel.errors import TaxelError
    from taxel_bench.chaos.bars import Bar
    from taxel_bench.chaos.flood import bars_of, client_processes, flood_of, oversize_of
    from taxel_bench.load.drive import server_at
    from taxel_bench.load.usage import listening_process
    from taxel_bench.machine import describe_machine
    from taxel_models.shipped import shipped_repository

    faults = [only] if only else ["flood", "oversize"]
    # Told to stop, it still stops its server and clients.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    results: dict[str, Any] = {}
    bars: list[Bar] = []
    with ERR.status("flooding"), server_at(connect, repository or shipped_repository()) as endpoint:
        server = listening_process(endpoint)
        if server is None:
            raise TaxelError(
                f"{endpoint}: no process of this machine that this user may look at listens there"
            )
        with client_processes(endpoint) as pool:
            if "flood" in faults:
                sizes = [int(size) for size in rows.split(",")]
                results["flood"] = [flood_of(pool, server, model, size, seconds) for size in sizes]
                bars += [bar for result in results["flood"] for bar in bars_of(result)]
            if "oversize" in faults:
                results["oversize"] = held = oversize_of(pool, server, model)
                bars.append(
                    Bar("400 MiB in one message: more MiB held", held["peak_mib"] - held["calm_mib"], 50)
                )
    verdict = "VALID" if all(bar.holds for bar in bars) else "INVALID"
    if as_json:
        told = {"machine": describe_machine(), "model": model, "seconds": seconds}
        print_json({**told, **results, "bars": [bar.as_dict() for bar in bars], "verdict": verdict})
        return
    table = Table("figure", "measured", "must be", "verdict")
    for bar in bars:
        table.add_row(bar.what, f"{bar.figure:.3g}", bar.wanted, "VALID" if bar.holds else "INVALID")
    OUT.print(table)
    OUT.print(verdict)

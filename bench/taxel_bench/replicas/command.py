"""`bench replicas`: whether requests are lost, and how long they take, while servers fail."""

from pathlib import Path
from typing import Annotated

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown


@needs("bench", "psutil")
def replicas(
    model: Annotated[str, typer.Option(help="The name of a served model.")] = "xgb",
    count: Annotated[int, typer.Option(min=2, max=16, help="How many servers.")] = 3,
    loops: Annotated[int, typer.Option(min=1, max=64, help="Control loops of 100 Hz that ask.")] = 4,
    seconds: Annotated[float, typer.Option(min=1, help="How long each phase lasts, at least.")] = 10.0,
    repository: Annotated[
        Path | None, typer.Option(help="What the servers serve; the shipped models if not set.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Kill, stop and restart servers while control loops ask them. Exit code 1: a request was lost.

    Times count from when a request was due, so that a loop that is held up does not hide it. The last phase
    takes as long as it takes to start all servers again.
    """
    from rich.table import Table

    from taxel_bench.machine import describe_machine
    from taxel_bench.replicas.measurement import measure
    from taxel_models.shipped import shipped_repository

    with shown("starting servers") as tell:
        phases = measure(
            repository or shipped_repository(),
            model,
            count,
            loops,
            seconds,
            tell,
        )
    lost = sum(phase["lost"] for phase in phases)
    if as_json:
        told = {"machine": describe_machine(), "model": model, "servers": count, "loops": loops}
        print_json({**told, "phases": phases, "lost": lost})
    else:
        table = Table("phase", "requests", "lost", "asked again", "p50 ms", "p99 ms", "max ms")
        for phase in phases:
            figures = ("requests", "lost", "repeated", "p50_ms", "p99_ms", "max_ms")
            table.add_row(phase["phase"], *(f"{phase[figure]:g}" for figure in figures))
        OUT.print(table)
    if lost:
        raise typer.Exit(1)

"""`bench reload`: what a control loop notices while versions are loaded beside it."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING


@needs("bench", *SERVING, "psutil")
def reload(
    loads: Annotated[int, typer.Option(min=1, help="How often the version is loaded again.")] = 100,
    rate: Annotated[float, typer.Option(min=1, max=5000, help="Steps of the loop in a second.")] = 200.0,
    transport: Annotated[Literal["lane", "zenoh"], typer.Option(help="Of the loop.")] = "lane",
    model: Annotated[str, typer.Option(help="The name of a served model.")] = "xgb",
    calm: Annotated[float, typer.Option(min=1, help="Seconds of calm before, to compare with.")] = 20.0,
    repository: Annotated[
        Path | None, typer.Option(help="What the server serves; the shipped models if not set.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Load a version again and again beside a control loop: the loop's round trips, and the memory."""
    from rich.table import Table

    from taxel_bench.machine import describe_machine
    from taxel_bench.reload.measurement import load_again, reasons_against
    from taxel_bench.server_process import running_server_process
    from taxel_models.shipped import shipped_repository

    machine = describe_machine()
    with (
        shown("starting the server") as tell,
        running_server_process(repository or shipped_repository(), "--watch-seconds", "0") as server,
    ):
        measured = load_again(
            server,
            model,
            transport,
            loads,
            rate,
            calm,
            lambda done: tell(f"{done} of {loads} loads"),
        )
    reasons = reasons_against(measured)
    verdict = "INVALID" if reasons else "VALID"
    if as_json:
        told = {"machine": machine, "model": model, "rate_hz": rate}
        told |= {"transport": transport, "verdict": verdict, "reasons": reasons}
        print_json({**told, **asdict(measured)})
        return
    table = Table("round trip, ms", *measured.calm.round_trip_ms, "steps", "late", "failed")
    for name, loop in (("calm", measured.calm), ("loading", measured.loading)):
        cells = [f"{value:.2f}" for value in loop.round_trip_ms.values()]
        table.add_row(name, *cells, *map(str, (loop.steps, loop.late, loop.failed)))
    OUT.print(table)
    memory = measured.memory_mib
    OUT.print(
        f"{loads} loads of {sum(measured.load_s) / loads:.1f} s; server: {memory[0]:.0f} MiB before, "
        f"{max(memory):.0f} at most, {memory[-1]:.0f} afterwards",
        soft_wrap=True,
    )
    OUT.print("; ".join([verdict, *reasons]), soft_wrap=True)

"""`bench simulator`: how fast a MuJoCo simulation runs alone, and with fingertips."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from taxel.commands.cli import Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING

_HEAD = "| fingers | model | predicts | real-time factor | mean, µs a step | median, µs | p99, µs | steps |"


@needs("bench", *SERVING, "psutil")
def simulator(
    fingers: Annotated[str, typer.Option(help="Numbers of fingertips, with commas between.")] = "1,64,4096",
    models: Annotated[
        str, typer.Option(help="Shipped models, with commas between; all if not given.")
    ] = "",
    seconds: Annotated[float, typer.Option(min=0.1, help="About how long to time each.")] = 2.0,
    of: Annotated[
        Path | None, typer.Option(help="Print the table of a JSON object that was kept; measure nothing.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Time a MuJoCo simulation alone, with a model in process, and with one behind a server."""
    import taxel
    import taxel.mujoco  # it names its extra before a server is started
    from taxel_bench.machine import describe_machine
    from taxel_bench.options import parse_names, parse_numbers
    from taxel_bench.server_process import ROOM, running_server
    from taxel_bench.simulator.measurement import TIMESTEP_S, measure
    from taxel_models.shipped import shipped_repository

    if of is not None:
        typer.echo(table(json.loads(of.read_text(encoding="utf-8"))))
        return
    counts = parse_numbers("--fingers", fingers, range(1, 65_537), "1 to 65536")
    machine, cells = describe_machine(), []
    repository = shipped_repository()
    with (
        shown("starting the server") as tell,
        running_server(repository, *ROOM) as endpoint,
        taxel.connect(endpoint) as remote,
        taxel.load(repository) as local,
    ):
        known = list(dict.fromkeys(each.name for each in local.models()))
        chosen = parse_names("--models", models, known, "model") if models else known
        for count in counts:
            for cell in measure(count, local, remote, chosen, seconds):
                cells.append(asdict(cell))
                tell(f"{count} fingers, {cell.model or 'physics'} {cell.where}")
    found = {"machine": machine, "timestep_s": TIMESTEP_S, "cells": cells}
    if as_json:
        print_json(found)
    else:
        typer.echo(table(found))


def table(found: dict[str, Any]) -> str:
    """The figures as a table in Markdown."""
    lines = [_HEAD, "| ---: | --- | --- | ---: | ---: | ---: | ---: | ---: |"]
    for cell in found["cells"]:
        figures = (f"{cell[name]:,.0f}" for name in ("mean_us", "median_us", "p99_us", "steps"))
        factor = f"{cell['real_time_factor']:.3g}"
        model = cell["model"] or "physics alone"
        where = {"alone": "", "local": "in process", "remote": "server"}[cell["where"]]
        lines.append(f"| {cell['fingers']:,} | {model} | {where} | {factor} | {' | '.join(figures)} |")
    return "\n".join(lines)

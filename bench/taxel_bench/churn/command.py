"""`bench churn`: what clients leave in a server that come, ask much, and go or are killed."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING


@needs("bench", *SERVING, "psutil")
def churn(
    clients: Annotated[
        int, typer.Option(min=1, help="Clients in all, each with a connection of its own.")
    ] = 1000,
    transport: Annotated[Literal["lane", "zenoh"], typer.Option(help="That they take.")] = "lane",
    model: Annotated[str, typer.Option(help="The name of a served model.")] = "xgb",
    rows: Annotated[int, typer.Option(min=1, max=65_536, help="Windows of a large request.")] = 8192,
    repository: Annotated[
        Path | None, typer.Option(help="What the server serves; the shipped models if not set.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Let clients come, send large requests and go or be killed: what does the server keep of them?"""
    from rich.table import Table

    from taxel_bench.churn.measurement import let_them_come, reasons_against
    from taxel_bench.machine import describe_machine
    from taxel_bench.server_process import ROOM, running_server_process
    from taxel_models.shipped import shipped_repository

    machine = describe_machine()
    with (
        shown("starting the server") as tell,
        running_server_process(repository or shipped_repository(), *ROOM) as server,
    ):
        held = let_them_come(
            server,
            model,
            transport,
            clients,
            rows,
            lambda gone: tell(f"{gone} of {clients} clients"),
        )
    reasons = reasons_against(held)
    verdict = "GROWS" if reasons else "FLAT"
    if as_json:
        print_json(
            {
                "machine": machine,
                "transport": transport,
                "model": model,
                "rows": rows,
                "verdict": verdict,
                "reasons": reasons,
                "held": [asdict(each) for each in held],
            }
        )
        return
    table = Table("clients", "memory MiB", "open files", "threads", "shared memory files")
    step = max(len(held) // 10, 1)
    for each in [*held[:-1:step], held[-1]]:
        cells = each.clients, f"{each.memory_mib:.0f}", each.files, each.threads, each.shared_files
        table.add_row(*map(str, cells))
    OUT.print(table)
    OUT.print("; ".join([verdict, *reasons]), soft_wrap=True)

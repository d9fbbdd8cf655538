"""`bench soak`: does a server that is left alone under mixed traffic grow?"""

import json
import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from taxel.atomic import check_folder_place, whole_folder
from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING

RESULT = "soak.json"


@needs("bench", *SERVING, "matplotlib", "psutil")
def soak(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder to write soak.json and a plot to.")
    ],
    minutes: Annotated[float, typer.Option(min=0.1, help="How long clients ask.")] = 20.0,
    model: Annotated[str, typer.Option(help="The name of a served model.")] = "xgb",
    repository: Annotated[
        Path | None, typer.Option(help="What the server serves; the shipped models if not set.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier result.")] = False,
    as_json: Json = False,
) -> None:
    """Ask a server for minutes: two control loops at 100 Hz, and visitors with large requests.

    Memory, open files, threads and p99 must be at the end what they were at the beginning.
    """
    from taxel_bench.chaos.printing import bars_table, verdict_of_bars
    from taxel_bench.machine import describe_machine
    from taxel_bench.server_process import running_server_process
    from taxel_bench.soak.measurement import as_dict, bars_of, soak_server
    from taxel_bench.soak.plot import draw_soak
    from taxel_models.shipped import shipped_repository

    check_folder_place(output, replacing=RESULT, overwrite=overwrite)
    # Told to stop, it still stops its server and clients.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    machine = describe_machine()
    with (
        shown("starting the server") as tell,
        running_server_process(repository or shipped_repository()) as server,
    ):
        run = soak_server(
            server,
            model,
            minutes * 60,
            lambda passed: tell(f"{passed / 60:.1f} of {minutes:g} minutes"),
        )
    bars = bars_of(run)
    told = {
        "machine": machine,
        "minutes": minutes,
        "model": model,
        "verdict": verdict_of_bars(bars),
        "bars": [bar.as_dict() for bar in bars],
        **as_dict(run),
    }
    with whole_folder(output, replacing=RESULT, overwrite=overwrite) as folder:
        (folder / RESULT).write_text(json.dumps(told, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        draw_soak(run, folder / "soak.png")
    if as_json:
        print_json(told)
        return
    OUT.print(bars_table(bars))
    OUT.print(f"{told['verdict']}. Wrote {output}.", soft_wrap=True, markup=False)

"""`bench compare`: Taxel's server and its peers, side by side in one run."""

import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING
from taxel_bench.options import Gaps, parse_gaps


@needs("bench", *SERVING, "psutil")
def compare(
    model: Annotated[
        str, typer.Option(help="A shipped network's name, or the folder of an ONNX artifact.")
    ] = "network-b",
    peers: Annotated[
        str, typer.Option(help="Servers to compare with, with commas between.")
    ] = "fastapi,litserve,ray,mosec,grpc",
    install: Annotated[
        bool, typer.Option("--install", help="Install peers that are not, each into its own environment.")
    ] = False,
    rounds: Annotated[int, typer.Option(min=1, help="Of Taxel and one peer in turn, for each peer.")] = 5,
    seconds: Annotated[float, typer.Option(min=0.05, help="Of each measurement in a turn.")] = 1.0,
    gap_ms: Gaps = "0",
    seed: Annotated[int, typer.Option(min=0, help="Of the windows.")] = 0,
    pin: Annotated[
        bool, typer.Option("--pin", help="Keep every client on one core and every server on the others.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the JSON object to this file, too.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare Taxel's server with other ways to serve the same network: latency, throughput, CPU."""
    from taxel.artifacts import MANIFEST, folder_of
    from taxel.atomic import check_file_place, write_json
    from taxel_bench.compare.comparison import CompareSettings, run_comparison
    from taxel_bench.compare.peers import parse_peers
    from taxel_bench.compare.printing import print_comparison
    from taxel_bench.machine import describe_machine
    from taxel_models.shipped import shipped_repository

    given = Path(model)
    folder = given.resolve() if (given / MANIFEST).is_file() else folder_of(shipped_repository(), model)
    settings = CompareSettings(
        folder, parse_peers(peers), install, rounds, seconds, seed, pin, parse_gaps(gap_ms)
    )
    if output is not None:
        check_file_place(output)
    machine = describe_machine()
    # Told to stop, it still stops the servers.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    with shown("starting") as tell:
        comparison = run_comparison(settings, tell)
    report = {
        "machine": machine,
        "model": model,
        "rounds": rounds,
        "seconds": seconds,
        "pinned": pin,
        **comparison.report(),
    }
    if output is not None:
        write_json(output, report)
    if as_json:
        print_json(report)
        return
    print_comparison(OUT, comparison)
    OUT.print(f"on {machine['cpu']}, {machine['cores']} cores, load {machine['load']}", soft_wrap=True)

"""`bench lane`: what one window over the lane takes, and what bounds it."""

import tempfile
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING
from taxel_bench.options import Gaps, Seed, parse_gaps

_WINDOWS = 1000


@needs("bench", *SERVING, "psutil")
def lane(
    model: Annotated[
        str, typer.Option(help="The name of a model, shipped or of the paper's size.")
    ] = "network-b",
    size: Annotated[
        Literal["shipped", "paper"], typer.Option(help="The shipped model, or one of the paper's size.")
    ] = "shipped",
    rounds: Annotated[int, typer.Option(min=1, help="Of all ways in turn.")] = 5,
    seconds: Annotated[float, typer.Option(min=0.05, help="Of each turn.")] = 1.0,
    gap_ms: Gaps = "0,1,10",
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """One window in process, over the lane and through a bare echo; and the lane's stages, one by one."""
    import shutil

    from taxel.artifacts import folder_of, read
    from taxel_bench.lane.measurement import measure
    from taxel_bench.lane.printing import print_lane
    from taxel_bench.lane.stages import measure_stages
    from taxel_bench.machine import describe_machine
    from taxel_bench.paper_size import write_paper_sized
    from taxel_bench.windows import random_windows
    from taxel_models.shipped import shipped_repository

    gaps_ms = parse_gaps(gap_ms)
    machine = describe_machine()
    with ExitStack() as stack:
        tell = stack.enter_context(shown("preparing the model"))
        repository = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="taxel-lane-")))
        if size == "paper":
            folder = write_paper_sized(repository, model, 1, seed=seed)
        else:
            shipped = folder_of(shipped_repository(), model)
            folder = repository / shipped.parent.name / shipped.name
            shutil.copytree(shipped, folder)
        manifest = read(folder).manifest
        windows = random_windows(manifest, _WINDOWS, seed)
        tell("all ways in turn")
        latencies = measure(repository, manifest.name, windows, gaps_ms, rounds, seconds)
        tell("stage by stage")
        stages = {
            f"{gap:g}": measure_stages(repository, manifest.name, windows, gap, seconds) for gap in gaps_ms
        }
    if as_json:
        print_json(
            {
                "machine": machine,
                "model": model,
                "size": size,
                "rounds": rounds,
                "seconds": seconds,
                "latency": {
                    gap: {way: asdict(latency) for way, latency in ways.items()}
                    for gap, ways in latencies.items()
                },
                "stages": stages,
            }
        )
        return
    print_lane(OUT, latencies, stages)

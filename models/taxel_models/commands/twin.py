"""`taxel twin`: write a simulated recording."""

from pathlib import Path
from typing import Annotated

import typer

from taxel.commands.frame import OUT, Json, print_json

Rows = Annotated[int, typer.Option("--rows", min=1, help="Length: 100 rows are a second.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Same seed and rows, same recording.")]
Output = Annotated[Path, typer.Option("--output", "-o", metavar="CSV", help="The file to write.")]


def twin(output: Output, rows: Rows = 60_000, seed: Seed = 7, as_json: Json = False) -> None:
    """Write a simulated recording of a BioTac 2P, in the CSV format of the published data set."""
    from taxel_models.recordings import write_ruppel
    from taxel_models.twin import simulate
    from taxel_models.twin.summary import summarise

    recording = simulate(rows, seed)
    write_ruppel(recording, output)
    summary = summarise(recording)
    if as_json:
        print_json({"output": str(output), "rows": rows, "seed": seed, **summary})
        return
    OUT.print(f"wrote {output}: {rows} rows ({rows / 100:g} s), seed {seed}, simulated", soft_wrap=True)
    for name, value in summary.items():
        OUT.print(f"  {name.replace('_', ' ')}: {value:.4g}")

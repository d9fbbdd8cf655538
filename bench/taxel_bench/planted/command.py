"""`bench planted`: a stranger's try of training, exporting and the loop, with causes planted in files."""

from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer

from taxel.atomic import check_file_place, write_json
from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown


@needs("bench", "xgboost", "scipy", "psutil")
def planted(
    data: Annotated[Path, typer.Option(metavar="FOLDER", envvar="TAXEL_DATA", help="Holds biotac_slide.")],
    seed: Annotated[int, typer.Option(min=0, help="Of the trials, and of what is planted.")] = 0,
    only: Annotated[
        str, typer.Option(help='Causes, with commas between, such as "offset,creep"; all if not given.')
    ] = "",
    one_material: Annotated[
        bool, typer.Option(help="Plant in trials of one material, in place of 60 of all.")
    ] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Recordings at a time.")] = 1,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="JSON of all recordings, kept after each."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Plant causes in copies of slide recordings, and ask the released commands for their names."""
    from rich.table import Table

    from taxel_bench.machine import describe_machine
    from taxel_bench.options import parse_names
    from taxel_bench.planted.causes import EVERY, PLANTED
    from taxel_bench.planted.measurement import Asked, Planted
    from taxel_models.ground.real import SLIDE, real_data

    chosen = [(name,) for name in parse_names("--only", only, list(PLANTED), "cause")] if only else EVERY
    recordings = real_data(data) / SLIDE
    if output is not None:
        check_file_place(output)
    contents: dict[str, Any] = {"machine": describe_machine(), "seed": seed, "one_material": one_material}
    found: list[Asked] = []
    with TemporaryDirectory() as folder, shown("training") as tell:
        asked = Planted(recordings, Path(folder), seed, one_material=one_material)
        asked.train()
        for one in asked.ask(chosen, jobs):
            found.append(one)
            contents |= {"right": sum(one.right for one in found), "recordings": [*map(asdict, found)]}
            if output is not None:
                write_json(output, contents)
            tell(f"{len(found)} of {len(chosen)} recordings")
    if as_json:
        print_json(contents)
        return
    table = Table("planted", "named", "right", "error before", "after")
    for one in found:
        figures = f"{one.before:.3f}", f"{one.after:.3f}"
        causes, named = (", ".join(names) or "nothing" for names in (one.planted, one.named))
        table.add_row(causes, named, "yes" if one.right else "no", *figures)
    OUT.print(table)
    OUT.print(f"{contents['right']} of {len(found)} have the right name first.")

"""The command `bench choice`."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from taxel.atomic import check_folder_place
from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import shown
from taxel.dependencies import SERVING
from taxel_bench.options import Seed


@needs("bench", *SERVING, "matplotlib", "psutil")
def choice(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write table and plot to.")],
    repository: Annotated[
        Path | None, typer.Option("--repository", metavar="REPO", help="The shipped models if none.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="A recording that no model was trained on; a twin's if none.")
    ] = None,
    repetitions: Annotated[int, typer.Option(min=10, help="Timed windows of each model.")] = 1000,
    seed: Seed = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier figures.")] = False,
    as_json: Json = False,
) -> None:
    """Compare all models of a repository on one recording: error, delay, warm-up, and latency.

    Writes choice.md, choice.json and choice.png. All models are compared at the same moments.
    """
    from taxel_bench.choice.files import FIGURES, markdown, write_files
    from taxel_bench.choice.measurement import compare_models, unseen_twin
    from taxel_bench.machine import describe_machine
    from taxel_models.recordings import read_recording
    from taxel_models.shipped import shipped_repository

    check_folder_place(output, replacing=FIGURES, overwrite=overwrite)
    with shown("reading"):
        recording = unseen_twin(seed) if data is None else read_recording(data)
    with shown("comparing"):
        compared = compare_models(repository or shipped_repository(), recording, repetitions, seed)
    figures = {
        "machine": describe_machine(),
        "recording": {"name": recording.name, "rows": len(recording), "sha256": recording.fingerprint},
        "repetitions": repetitions,
        "models": [asdict(model) for model in compared],
    }
    write_files(output, figures, compared, overwrite=overwrite)
    if as_json:
        print_json(figures)
    else:
        OUT.print(markdown(compared), markup=False, soft_wrap=True)

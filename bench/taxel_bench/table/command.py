"""The command `bench table`."""

from pathlib import Path
from typing import Annotated

import typer

from taxel.atomic import check_folder_place, whole_folder
from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.dependencies import SERVING
from taxel.errors import SettingsError
from taxel.windows import COMBINATIONS
from taxel_bench.options import Repetitions, Seconds, Seed, parse_batches, parse_numbers

_MODELS = ("network-b", "xgb", "ffnn", "transformer")


@needs("bench", *SERVING, "matplotlib", "psutil", "sklearn", "torch", "xgboost")
def table(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write the table and plots to.")],
    models: Annotated[str, typer.Option(help="Which models, with commas between.")] = ",".join(_MODELS),
    inputs: Annotated[str, typer.Option(help="Which input combinations.")] = "1,2,3,4,5,6,7,8",
    batch: Annotated[
        str, typer.Option(help="Windows a call for the plot of latency, at the first combination.")
    ] = "1,8,64,1024",
    repetitions: Repetitions = None,
    seconds: Seconds = 60.0,
    seed: Seed = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier table.")] = False,
    as_json: Json = False,
) -> None:
    """Measure the paper's inference table again: parameters, time and operations, with Taxel beside it.

    Writes table.md, table.json and two plots. `--json` prints what table.json holds: `machine` and
    `results`, with the fields of `bench run` and what was `published`.
    """
    from taxel_bench.machine import describe_machine
    from taxel_bench.progress import progress_bar, shifted
    from taxel_bench.run.protocols import Effort
    from taxel_bench.table.cells import measure_cell
    from taxel_bench.table.files import TABLE, markdown, write_files

    chosen = models.split(",")
    if not chosen or any(name not in _MODELS for name in chosen):
        raise SettingsError(f"--models {models}: expected some of {', '.join(_MODELS)}, commas between")
    combinations = parse_numbers("--inputs", inputs, COMBINATIONS, "1 to 8")
    batches = sorted({1, *parse_batches(batch)})
    check_folder_place(output, replacing=TABLE, overwrite=overwrite)
    effort = Effort(repetitions, seconds, seed)
    machine, results = describe_machine(), []
    cells = [(model, combination) for model in chosen for combination in combinations]
    with progress_bar("loading", len(cells)) as bar:
        for done, (model, combination) in enumerate(cells):
            bar.say(f"{model}, inputs {combination}")
            sizes = batches if combination == combinations[0] else [1]
            results += measure_cell(model, combination, sizes, effort, shifted(bar.reach, done))
    with whole_folder(output, replacing=TABLE, overwrite=overwrite) as folder:
        write_files(folder, machine, results)
    if as_json:
        print_json({"machine": machine, "results": results})
        return
    OUT.print(markdown(machine, results), soft_wrap=True, markup=False)
    OUT.print(f"Wrote {output}.", soft_wrap=True, markup=False)

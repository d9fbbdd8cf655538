"""`taxel train`: fit a model to recordings."""

import json
import os
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.table import Table

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import bar
from taxel.errors import SettingsError


@needs("train", "matplotlib")
def train(
    data: Annotated[
        list[Path],
        typer.Option("--data", metavar="PATH", help="A recording: a CSV file or a folder. Repeatable."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write the trained model to.")],
    model: Annotated[str, typer.Option(help="Model family.")] = "xgb",
    inputs: Annotated[int, typer.Option(min=1, max=8, help="Input combination.")] = 1,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Replace a hyperparameter. Repeatable."),
    ] = None,
    hyperparameters: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Hyperparameters that `taxel search` found; --set overrides them."
        ),
    ] = None,
    holdout: Annotated[
        Literal["auto", "trials", "chunks"],
        typer.Option(
            help="What to hold out; chunks have 1000 rows, and auto takes trials if there are any."
        ),
    ] = "auto",
    test: Annotated[float, typer.Option(help="Share of trials or chunks held out for testing.")] = 0.1,
    validation: Annotated[float, typer.Option(help="Share held out for early stopping.")] = 0.1,
    members: Annotated[
        str | None,
        typer.Option(
            metavar="FAMILY:COUNT,…", help="For an ensemble; `--set FAMILY.NAME=VALUE` sets theirs."
        ),
    ] = None,
    temperature: Annotated[
        Literal["measured", "mean", "none"],
        typer.Option(
            help="For network-a and network-b: `measured` makes it an input of the served model, "
            "`mean` trains with it and then fixes it at its mean, `none` leaves it out."
        ),
    ] = "mean",
    split_seed: Annotated[int, typer.Option(help="Seed of the split.")] = 0,
    seed: Annotated[int, typer.Option(help="Seed of every other random choice.")] = 0,
    jobs: Annotated[int, typer.Option(min=0, help="Cores to use; 0 takes all.")] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing folder.")] = False,
    as_json: Json = False,
) -> None:
    """Train a model on recordings; whole trials or chunks are held out to test it."""
    from taxel.atomic import check_folder_place
    from taxel_models.families.registry import family
    from taxel_models.recordings import read_recording
    from taxel_models.training.hyperparameters import read_hyperparameters
    from taxel_models.training.split import SplitSettings
    from taxel_models.training.train import TrainingSettings
    from taxel_models.training.train import train as fit
    from taxel_models.training.trained import RECORD, save

    output = output.resolve()
    check_folder_place(output, replacing=RECORD, overwrite=overwrite)
    family(model)  # An unknown family or a library that is not installed is told before a long reading.
    found = read_hyperparameters(hyperparameters, model, inputs) if hyperparameters else {}
    output.parent.mkdir(parents=True, exist_ok=True)
    training_settings = TrainingSettings(
        model=model,
        combination=inputs,
        split=SplitSettings(holdout, test, validation, split_seed),
        seed=seed,
        overrides=found | parse_settings(settings or []) | ({"members": members} if members else {}),
        extras=temperature,
        checkpoint=output.with_name(f".{output.name}.checkpoint"),
        jobs=jobs or os.cpu_count() or 1,
    )
    with bar("reading") as progress:
        recordings = [
            read_recording(
                path,
                lambda read, trials: progress.reach(read / trials, f"{read} of {trials} trials"),
            )
            for path in data
        ]
        progress.say("training")
        trained, held_out = fit(recordings, training_settings, progress.reach)
        progress.say("writing")
        save(trained, held_out, output, overwrite=overwrite)
    record = trained.record
    if as_json:
        print_json({"output": str(output), **record.model_dump(mode="json")})
        return
    OUT.print(_table(record.training.metrics))
    counts = record.training.windows
    parts = ", ".join(f"{count} {part}" for part, count in counts.items())
    OUT.print(f"Windows: {parts}.")
    if still := record.training.metrics["test"]["still"]:
        OUT.print(
            f"Hardly moving in the held-out data: {', '.join(still)}. Small errors there prove little."
        )
    OUT.print(f"Parameters: {record.parameters}. Best at {record.history.unit} {record.history.best}.")
    OUT.print(f"Wrote {output}. Next: taxel export {output} --repository REPO", soft_wrap=True)


def parse_settings(settings: list[str]) -> dict[str, Any]:
    """`name=value` pairs. A value that is JSON (a number, a list) is read as JSON; any other is text.

    Raises:
        SettingsError: a pair has no '='.
    """
    chosen: dict[str, Any] = {}
    for setting in settings:
        name, sign, text = setting.partition("=")
        if not sign or not name:
            raise SettingsError(f"--set {setting}: expected NAME=VALUE")
        try:
            chosen[name] = json.loads(text)
        except ValueError:
            chosen[name] = text
    return chosen


def _table(metrics: dict[str, Any]) -> Table:
    table = Table("on held-out data", "MAE", "norm. MAE", "MAE electrodes", "norm. MAE electrodes")
    for label, key in (("model", "test"), ("mean predictor", "mean_predictor")):
        errors = metrics[key]
        table.add_row(
            label,
            f"{errors['mae']:.3f}",
            f"{errors['norm_mae']:.3f}",
            f"{errors['mae_electrodes']:.3f}",
            f"{errors['norm_mae_electrodes']:.3f}",
        )
    return table

"""`taxel search`: find hyperparameters with SMAC3."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import bar

if TYPE_CHECKING:
    from distributed import Client

    from taxel_models.search.run import Outcome

_SHOWN = 5


@needs("study", "ConfigSpace", "dask", "distributed", "matplotlib", "scipy", "smac")
def search(
    data: Annotated[
        list[Path],
        typer.Option("--data", metavar="PATH", help="A recording: a CSV file or a folder. Repeatable."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder of the search; an unfinished one is continued.")
    ],
    model: Annotated[str, typer.Option(help="Model family: xgb, ffnn or transformer.")] = "xgb",
    inputs: Annotated[int, typer.Option(min=1, max=8, help="Input combination.")] = 1,
    trials: Annotated[int, typer.Option(min=1, help="Fits in all.")] = 100,
    walltime: Annotated[
        float | None, typer.Option(metavar="S", help="Stop after so many seconds, over all continuations.")
    ] = None,
    budget: Annotated[
        int, typer.Option(min=1, help="Epochs of a network's longest trials (Hyperband's largest budget).")
    ] = 30,
    least_budget: Annotated[int, typer.Option(min=1, help="Epochs of its shortest trials.")] = 3,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="Set a hyperparameter instead of searching it. Repeatable."
        ),
    ] = None,
    holdout: Annotated[
        Literal["auto", "trials", "chunks"], typer.Option(help="What to hold out, as in `taxel train`.")
    ] = "auto",
    test: Annotated[
        float, typer.Option(help="Share held out for testing: the search never sees it.")
    ] = 0.1,
    validation: Annotated[float, typer.Option(help="Share on which configurations are compared.")] = 0.1,
    split_seed: Annotated[int, typer.Option(help="Seed of the split.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of every other random choice.")] = 0,
    jobs: Annotated[int, typer.Option(min=0, help="Cores for one trial; 0 takes all.")] = 0,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Fit on a Dask cluster; --jobs is then 1."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Search the paper's hyperparameter spaces for the least normalised MAE on the validation set.

    `--json` prints output, hyperparameters, cost, epochs, trials, diverged and seconds_fitting.
    """
    from taxel_models.commands.train import parse_settings
    from taxel_models.recordings import read_recording
    from taxel_models.search.objective import fit_task
    from taxel_models.search.run import search as run
    from taxel_models.search.search_results import WINNER, summary, write_report
    from taxel_models.search.search_settings import SearchSettings

    output = output.resolve()
    with bar("reading") as progress, _cluster(scheduler) as client:
        recordings = [read_recording(path) for path in data]
        search_settings = SearchSettings.of(
            recordings,
            family=model,
            combination=inputs,
            trials=trials,
            walltime_s=walltime,
            epochs=budget,
            least_epochs=min(least_budget, budget),
            held=parse_settings(settings or []),
            seed=seed,
            grouping=holdout,
            test=test,
            validation=validation,
            split_seed=split_seed,
        )
        task = fit_task(recordings, search_settings, 1 if client else jobs or os.cpu_count() or 1)
        progress.say("searching")
        outcome = run(
            search_settings,
            task,
            output,
            client=client,
            progress=progress.reach,
        )
        write_report(search_settings, outcome, output)
    winner = output / WINNER
    if as_json:
        chosen = outcome.winner.hyperparameters
        print_json({"output": str(output), "hyperparameters": chosen, **summary(outcome)})
        return
    OUT.print(_table(outcome))
    OUT.print(
        f"Wrote {output}. Next: taxel train --model {model} --inputs {inputs} --hyperparameters {winner}",
        soft_wrap=True,
    )


@contextmanager
def _cluster(address: str | None) -> Iterator["Client | None"]:
    if address is None:
        yield None
        return
    from taxel_models.training.cluster import connect

    with connect(address) as client:
        yield client


def _table(outcome: "Outcome") -> Table:
    table = Table(
        "trial", "norm. MAE", "epochs", "parameters", title=f"best of {len(outcome.trials)} trials"
    )
    for trial in outcome.best(_SHOWN):
        parameters = trial.about.get("parameters")
        table.add_row(
            str(trial.number),
            f"{trial.cost:.4f}",
            str(trial.epochs or ""),
            f"{parameters:,}" if parameters is not None else "diverged",
        )
    return table

"""`taxel models`: what a server or a repository offers."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from taxel.commands.cli import OUT, Json, print_json
from taxel.errors import SettingsError
from taxel.predictor import ModelInfo, PredictorSource

Connect = Annotated[
    str | None, typer.Option("--connect", metavar="ENDPOINT", help="A running server, as tcp/HOST:PORT.")
]
Repository = Annotated[
    Path | None,
    typer.Option(
        "--repository",
        metavar="REPO",
        help="A repository folder, in this process; without either, the models that come with Taxel.",
    ),
]


def open_source(connect: str | None, repository: Path | None) -> PredictorSource:
    """The server or the repository that a command line names; if none, the shipped models.

    Raises:
        SettingsError: both are named.
    """
    import taxel

    if connect is None:
        return taxel.load(repository)
    if repository is None:
        return taxel.connect(connect)
    raise SettingsError("expected --connect ENDPOINT or --repository REPO, not both")


def models(connect: Connect = None, repository: Repository = None, as_json: Json = False) -> None:
    """List the models of a server or a repository, or those that come with Taxel."""
    with open_source(connect, repository) as source:
        offered = source.models()
    if as_json:
        print_json({"models": [asdict(model) for model in offered]})
        return
    OUT.print(_table(offered))
    by: dict[str, list[str]] = {}
    for model in offered:
        by.setdefault(_evaluator(model), []).append(f"{model.name}/{model.version}")
    for evaluator, users in by.items():
        OUT.print(f"{evaluator}: {', '.join(users)}", markup=False, soft_wrap=True)
    for model in offered:
        if model.shadow:
            OUT.print(f"{model.name}/{model.version} is a shadow: taxel top shows how it differs")
        if model.reason:
            OUT.print(f"{model.name}/{model.version}: {model.reason}", markup=False, soft_wrap=True)


def _table(offered: list[ModelInfo]) -> Table:
    """A row for each model. No name is cut off.

    Errors are those on what training held out: figures of models that were trained on other recordings
    cannot be compared.
    """
    table = Table()
    for heading in ("model", "state", "inputs", "delay", "warm-up", "norm. MAE"):
        table.add_column(heading, overflow="fold")
    for model in offered:
        combination = "" if model.combination is None else str(model.combination)
        live = (_milliseconds(model.delay_s), _milliseconds(model.warm_up_s))
        error = "" if model.norm_mae is None else f"{model.norm_mae:.3f}"
        table.add_row(f"{model.name}/{model.version}", model.state, combination, *live, error)
    return table


def _evaluator(model: ModelInfo) -> str:
    """What evaluates a model where it is loaded; else what it was exported for."""
    if not model.one_row:
        return f"for {model.platform}"
    instructions = f" ({model.instruction_set})" if model.instruction_set else ""
    return f"one row by {model.one_row}, many by {model.many_rows}{instructions}"


def _milliseconds(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds * 1e3:g} ms"

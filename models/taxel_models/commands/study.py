"""`taxel study`: repeat the paper's study on any recording."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table

from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.progress import bar

if TYPE_CHECKING:
    from taxel_models.recordings import Recording
    from taxel_models.study.summary import Summary


@needs("study", "dask", "distributed", "jinja2", "matplotlib", "scipy", "statsmodels")
def study(
    data: Annotated[
        list[Path],
        typer.Option("--data", metavar="PATH", help="A recording: a CSV file or a folder. Repeatable."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder of the study; an unfinished one is continued.")
    ],
    models: Annotated[
        str, typer.Option(metavar="NAME,…", help="Model families.")
    ] = "network-b,xgb,ffnn,transformer",
    inputs: Annotated[str, typer.Option(metavar="N,…", help="Input combinations.")] = "1-8",
    folds: Annotated[int, typer.Option(min=2, help="Folds of the cross-validation.")] = 10,
    protocol: Annotated[
        Literal["strict", "paper", "both"],
        typer.Option(
            help="`strict` lets nothing leak; `paper` repeats the published choices; "
            "`both` shows the size of the leak."
        ),
    ] = "strict",
    unit: Annotated[
        Literal["auto", "trials", "chunks", "sessions"],
        typer.Option(
            help="What `strict` holds out whole; auto takes sessions (recordings) if there is one "
            "a fold, else trials if there are any, else chunks of 1000 rows."
        ),
    ] = "auto",
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="MODEL.NAME=VALUE", help="Replace a hyperparameter. Repeatable."),
    ] = None,
    rows: Annotated[
        int | None,
        typer.Option(min=1, help="Reduced scale: whole groups, drawn at random, of so many rows or more."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the folds, the reduction and the fits.")] = 0,
    jobs: Annotated[int, typer.Option(min=0, help="Cores for one cell; 0 takes all.")] = 0,
    temperature: Annotated[
        bool,
        typer.Option(
            "--temperature",
            help="Test network-b, inputs 1, with every temperature that occurs, as in the paper.",
        ),
    ] = False,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Compute on a Dask cluster; --jobs is then 1."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare models and input combinations by cross-validation, as the paper does."""
    from taxel_models.commands.train import parse_settings
    from taxel_models.study.cluster import cluster_runner
    from taxel_models.study.run import Study, compute_here, run_study
    from taxel_models.study.store import Store
    from taxel_models.study.study_report import RESULTS, describe, scale_statement, write_report
    from taxel_models.study.study_settings import (
        PROTOCOLS,
        StudySettings,
        parse_combinations,
        parse_overrides,
    )
    from taxel_models.study.summary import Summary

    study_settings = StudySettings(
        models=tuple(name.strip() for name in models.split(",")),
        combinations=parse_combinations(inputs),
        protocols=PROTOCOLS if protocol == "both" else (protocol,),
        folds=folds,
        grouping=unit,
        rows=rows,
        seed=seed,
        overrides=parse_overrides(parse_settings(settings or [])),
        temperature=temperature,
    )
    study_settings.check()
    store = Store(output)
    with bar("reading") as progress:
        chosen = Study.of(study_settings, _read(data))
        progress.say("cells")
        results = run_study(
            chosen,
            store,
            cluster_runner(scheduler) if scheduler else compute_here,
            1 if scheduler else jobs or os.cpu_count() or 1,
            progress.reach,
        )
        progress.say("writing")
        write_report(chosen, results, store.folder)
    if as_json:
        print_json({"output": str(store.folder), **describe(chosen, results)})
        return
    OUT.print(scale_statement(chosen).replace("**", ""), markup=False, soft_wrap=True)
    for name in study_settings.protocols:
        OUT.print(_table(Summary(name, results)))
    OUT.print(f"Wrote {store.folder / RESULTS}, tables and pictures beside it.", soft_wrap=True)


def _read(paths: list[Path]) -> "list[Recording]":
    from taxel_models.recordings import read_recording

    return [read_recording(path) for path in paths]


def _table(summary: "Summary") -> Table:
    table = Table(title=f"protocol {summary.protocol}: mean (standard deviation) over folds")
    table.add_column("model, inputs", no_wrap=True)
    for heading in ("parameters", "MAE", "norm. MAE", "norm. MAE el.", "norm. RMSE"):
        table.add_column(heading, justify="right")
    for entry in summary.entries.values():
        figures = entry.figures()
        table.add_row(
            f"{entry.model} {entry.combination}",
            f"{entry.parameters:,.0f}",
            *(
                f"{figures[key]['mean']:.3f} ({figures[key]['std']:.3f})"
                for key in ("mae", "norm_mae", "norm_mae_electrodes", "norm_rmse")
            ),
        )
    mean = summary.mean_predictor()
    table.add_row(
        "mean predictor",
        "",
        *(f"{mean[key]['mean']:.3f}" for key in ("mae", "norm_mae", "norm_mae_electrodes", "norm_rmse")),
    )
    return table

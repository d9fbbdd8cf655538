"""`taxel loop-trial`: causes are injected, the loop has to find them without knowing, and is marked."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import typer
from rich.table import Table

from taxel.atomic import check_file_place, write_json
from taxel.commands.cli import OUT, Json, needs, print_json
from taxel.commands.models import Repository
from taxel.commands.progress import bar
from taxel.dependencies import SERVING, require
from taxel_models.ground import GroundName

if TYPE_CHECKING:
    from taxel_models.recovery.rounds import Rate, Round, Summary
    from taxel_models.recovery.sensitivity import Sensitivity


@needs("loop", *SERVING, "scipy", "threadpoolctl")
def loop_trial(
    trials: Annotated[int, typer.Option(min=1, help="Rounds.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Of recordings, effects and strengths.")] = 0,
    model: Annotated[
        str, typer.Option(help="A model of the twin; slide and lasa train their own.")
    ] = "network-b",
    repository: Repository = None,
    rows: Annotated[int, typer.Option(min=5_000, help="Of each twin; 100 are a second.")] = 60_000,
    ground: Annotated[
        GroundName,
        typer.Option(help="Where causes are injected. Real ones first train a model on other trials."),
    ] = "twin",
    injector: Annotated[
        Literal["own", "foreign"],
        typer.Option(help="`own`: the loop's effects; `foreign`: causes of other forms."),
    ] = "own",
    data: Annotated[
        Path | None,
        typer.Option(envvar="TAXEL_DATA", metavar="FOLDER", help="Holds biotac_slide and lasa_contact."),
    ] = None,
    one_of: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMN",
            help="Each round plays one value of a column, such as `material`; with --ground slide.",
        ),
    ] = None,
    unseen: Annotated[
        bool,
        typer.Option(
            help="The model was not trained on a quarter of the materials; with --one-of, "
            "of that column's values, and each round plays one of these."
        ),
    ] = False,
    all_days: Annotated[
        bool,
        typer.Option(help="Each round plays trials of all days, in place of one; with --ground slide."),
    ] = False,
    models: Annotated[
        int,
        typer.Option(min=1, help="Base models that take turns, each trained on other trials; slide, lasa."),
    ] = 1,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="A cause that may be injected. Repeatable; all if none is given."
        ),
    ] = None,
    strength: Annotated[
        tuple[float, float], typer.Option(help="Least and greatest strength over the residual.")
    ] = (0.5, 2.0),
    pairs: Annotated[bool, typer.Option("--pairs", help="Inject two causes at a time.")] = False,
    clean: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of rounds without a cause.")] = 0.2,
    unknown: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of rounds with a cause that no effect describes.")
    ] = 0.1,
    jobs: Annotated[int, typer.Option(min=1, help="Processes; they change no result.")] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Play on a Dask cluster; --jobs then only trains."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="JSON file for every round; written as it goes.")
    ] = None,
    plots: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Draw the confusion matrix and the power curves there."),
    ] = None,
    sensitivity: Annotated[
        bool,
        typer.Option(
            "--sensitivity",
            help="Play the same rounds with each constant of the inference at half and at twice its value.",
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Inject causes into recordings, let the loop find them without knowing, and count.

    By default a fifth of the rounds have none, a tenth a cause that no effect describes; strengths are
    half to twice the residual that was there before. Prints the confusion matrix, false alarms with 95 %
    intervals, parameter errors, and the share of the removable error that was removed.
    """
    from taxel_models.ground.twins import StoredModel
    from taxel_models.loop.inference.constants import DECLARED
    from taxel_models.recovery.benchmark import RecoveryBenchmark
    from taxel_models.recovery.chosen_ground import ChosenGround
    from taxel_models.recovery.injected import Draw
    from taxel_models.recovery.rounds import summarise
    from taxel_models.recovery.sensitivity import sensitivities
    from taxel_models.recovery.workers import run_rounds_on, run_rounds_with
    from taxel_models.shipped import shipped_repository

    stored = StoredModel(repository or shipped_repository(), model)
    chosen = ChosenGround(
        ground, seed, stored, injector, rows, data, jobs, one_of, unseen, all_days, models
    )
    _prepare(scheduler, plots, output)
    draw = Draw(injector, tuple(only or ()), strength, pairs, clean, unknown)
    rounds: list[Round] = []
    moved: list[Sensitivity] = []
    with bar("preparing the ground") as progress:
        benchmark = RecoveryBenchmark(chosen.prepare(progress.say), ground, seed, draw)
        progress.say("playing rounds")
        for finished in run_rounds_on(benchmark, trials, jobs, scheduler):
            rounds.append(finished)
            note = f"{len(rounds)} of {trials}: {finished.truth} found as {finished.found}"
            progress.reach(len(rounds) / trials, note)
            if output is not None:
                write_json(output, _content(rounds, summarise(rounds)))
        if sensitivity:
            progress.say("moving each constant")
            play = partial(run_rounds_with, benchmark, rounds=trials, jobs=jobs, scheduler=scheduler)
            for one in sensitivities(benchmark.constants, rounds, play):
                moved.append(one)
                share = len(moved) / (2 * len(DECLARED.names()))
                progress.reach(share, f"{one.constant} at {one.value:g}")
                if output is not None:
                    write_json(output, _content(rounds, summarise(rounds), moved))
    summary = summarise(rounds)
    if plots is not None:
        from taxel_models.recovery.pictures import write_pictures

        write_pictures(summary, plots)
    if as_json:
        print_json(_content(rounds, summary, moved))
    else:
        _show(summary, moved)


def _prepare(scheduler: str | None, plots: Path | None, output: Path | None) -> None:
    """Refuse what cannot be done before anything is played."""
    if scheduler is not None:
        require("--scheduler", "study", "dask", "distributed")
    if plots is not None:
        require("--plots", "plot", "matplotlib")
        plots.mkdir(parents=True, exist_ok=True)
    if output is not None:
        check_file_place(output)


def _content(
    rounds: list["Round"], summary: "Summary", moved: Sequence["Sensitivity"] = ()
) -> dict[str, object]:
    content: dict[str, object] = {
        "summary": summary.model_dump(mode="json"),
        "rounds": [each.model_dump(mode="json", by_alias=True) for each in rounds],
    }
    if moved:
        content["sensitivity"] = [each.model_dump(mode="json") for each in moved]
    return content


_RATES: Final = {
    "right_first": "right effect first",
    "right_or_confounded": "right effect first, or reported as not to be told apart",
    "all_named": "every injected cause named",
    "false_alarms": "false alarms on clean recordings",
    "models_alarmed": "base models with a false alarm",
    "unknown_left": "unknown causes left unexplained",
    "change_told": "a line on the electrode that is dying",
    "change_false": "a line on a channel whose sensitivity did not change",
}


def _show(summary: "Summary", moved: Sequence["Sensitivity"]) -> None:
    table = Table("injected", "rounds", "found first", title="Found first, by what was injected")
    for truth, counts in summary.confusion.items():
        most = sorted(counts.items(), key=lambda one: (-one[1], one[0]))
        table.add_row(
            truth, str(sum(counts.values())), ", ".join(f"{name} {times}" for name, times in most)
        )
    OUT.print(table)
    for name, text in _RATES.items():
        rate = summary.rates.get(name)
        if rate is None:
            OUT.print(f"{text}: -")
        else:
            counted = f"{rate.hits} of {rate.rounds}, 95 % interval {rate.low:.1%} to {rate.high:.1%}"
            OUT.print(f"{text}: {rate.share:.1%} ({counted})")
    for text, value in (
        ("of the removable error removed, where right (median)", summary.removed),
        ("of the removable error removed, where right (all together)", summary.removed_mean),
        ("time constants, delays and angles within 20 %", summary.parameters_within),
    ):
        OUT.print(f"{text}: {'-' if value is None else f'{value:.1%}'}")
    if moved:
        _show_sensitivity(summary, moved)


def _show_sensitivity(summary: "Summary", moved: Sequence["Sensitivity"]) -> None:
    names = ("right_first", "false_alarms", "unknown_left")
    title = "Each constant of the inference at half and at twice its value"
    table = Table("constant", "value", "other name first", *(_RATES[name] for name in names), title=title)

    def told(rate: "Rate | None") -> str:
        return "-" if rate is None else f"{rate.hits} of {rate.rounds}"

    table.add_row("as declared", "", "", *(told(summary.rates.get(name)) for name in names))
    for one in moved:
        own = (told(one.summary.rates.get(name)) for name in names)
        table.add_row(one.constant, f"{one.value:g}", f"{one.changed} of {one.rounds}", *own)
    OUT.print(table)

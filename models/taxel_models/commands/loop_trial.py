"""`taxel loop-trial`: effects are injected, the loop has to find them without knowing, and is marked."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import Progress
from rich.table import Table

from taxel.atomic import check_file_place, whole_file
from taxel.commands.cli import ERR, OUT, Json, needs, print_json
from taxel.commands.models import Repository
from taxel.dependencies import SERVING

if TYPE_CHECKING:
    from taxel_models.recovery.benchmark import Round, Summary


@needs("loop", *SERVING, "scipy", "threadpoolctl")
def loop_trial(
    trials: Annotated[int, typer.Option(min=1, help="Rounds.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Of recordings, effects and strengths.")] = 0,
    model: Annotated[str, typer.Option(help="A model of the twin.")] = "network-b",
    repository: Repository = None,
    rows: Annotated[int, typer.Option(min=20_000, help="Of each recording; 100 are a second.")] = 60_000,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="JSON file for every round; written as it goes.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Inject effects into the twin, let the loop find them without knowing, and count.

    A fifth of the rounds have none, a tenth a cause that no effect describes; strengths are half to
    twice the residual that was there before. Prints the confusion matrix, false alarms, parameter
    errors, and the share of the removable error that was removed.
    """
    import taxel
    from taxel_models.recovery.benchmark import RecoverySettings, run_rounds, summarise

    if output is not None:
        check_file_place(output)
    rounds: list[Round] = []
    with (
        taxel.load(repository) as source,
        Progress(console=ERR, disable=not ERR.is_terminal) as progress,
    ):
        predictor = source.predictor(model)
        task = progress.add_task("rounds", total=trials)
        for finished in run_rounds(predictor, RecoverySettings(trials, seed, rows)):
            rounds.append(finished)
            progress.update(task, advance=1, description=f"{finished.truth} found as {finished.found}")
            if output is not None:
                _write(output, _content(rounds, summarise(rounds)))
    summary = summarise(rounds)
    if as_json:
        print_json(_content(rounds, summary))
    else:
        _show(summary)


def _content(rounds: list["Round"], summary: "Summary") -> dict[str, Any]:
    return {
        "summary": summary.model_dump(mode="json"),
        "rounds": [each.model_dump(mode="json", by_alias=True) for each in rounds],
    }


def _write(path: Path, content: dict[str, Any]) -> None:
    import json

    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _show(summary: "Summary") -> None:
    found = sorted({name for counts in summary.confusion.values() for name in counts})
    table = Table("injected", *found, title="Found first, by what was injected")
    for truth, counts in summary.confusion.items():
        table.add_row(truth, *(str(counts.get(name, "")) for name in found))
    OUT.print(table)
    for text, value in (
        ("right effect first", summary.right_first),
        ("right effect first, or reported as not to be told apart", summary.right_or_confounded),
        ("false alarms on clean recordings", summary.false_alarms),
        ("unknown causes left unexplained", summary.unknown_left),
        ("of the removable error removed, where right (median)", summary.removed),
        ("of the removable error removed, where right (all together)", summary.removed_mean),
        ("time constants, delays and angles within 20 %", summary.parameters_within),
    ):
        OUT.print(f"{text}: {'-' if value is None else f'{value:.1%}'}")

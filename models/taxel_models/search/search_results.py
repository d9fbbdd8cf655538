"""The results of a search on disk, beside the state that continues it.

DIR/search.json             the settings
DIR/hyperparameters.json    the winner, for `taxel train --hyperparameters`
DIR/trials.json             every trial that finished
DIR/best.md                 the best configurations
DIR/trials.png              cost over trials, and the best so far
DIR/smac.log, DIR/smac/     SMAC's log and state
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from taxel import __version__
from taxel.atomic import whole_file, write_json, write_text
from taxel_models.search.cost_plot import draw_trials
from taxel_models.search.objective import WORST
from taxel_models.search.run import Outcome, SearchTrial
from taxel_models.search.search_settings import SearchSettings
from taxel_models.training.hyperparameters import FoundHyperparameters

WINNER: Final = "hyperparameters.json"
BEST: Final = 10
"""Rows of the table."""


def write_report(settings: SearchSettings, outcome: Outcome, folder: Path) -> None:
    """Write the results; each file appears whole or not at all, and replaces an earlier one."""
    found = FoundHyperparameters(
        family=settings.family,
        combination=settings.combination,
        hyperparameters=outcome.winner.hyperparameters,
        origin={"taxel_version": __version__, **summary(outcome), "data": settings.data},
    )
    write_text(folder / WINNER, found.model_dump_json(indent=1) + "\n")
    write_json(folder / "trials.json", [asdict(trial) for trial in outcome.trials])
    write_text(folder / "best.md", _markdown(settings, outcome))
    title = f"search: {settings.family}, input combination {settings.combination}"
    with whole_file(folder / "trials.png") as temporary, temporary.open("wb") as picture:
        draw_trials(outcome, title, picture)


def summary(outcome: Outcome) -> dict[str, Any]:
    """The figures of a search, for JSON."""
    return {
        "cost": outcome.winner.cost,
        "epochs": outcome.winner.epochs,
        "trials": len(outcome.trials),
        "diverged": sum(trial.cost >= WORST for trial in outcome.trials),
        "seconds_fitting": sum(trial.seconds for trial in outcome.trials),
    }


def _markdown(settings: SearchSettings, outcome: Outcome) -> str:
    best = outcome.best(BEST)
    names = list(dict.fromkeys(name for trial in best for name in trial.hyperparameters))
    head = ["trial", "normalised MAE", "epochs", "parameters", *names]
    lines = [
        f"The best of {len(outcome.trials)} trials of {settings.family}, "
        f"input combination {settings.combination}. Normalised MAE on the validation set.",
        "",
        f"| {' | '.join(head)} |",
        "| --- " * len(head) + "|",
    ]
    lines += [f"| {' | '.join(_row(trial, names))} |" for trial in best]
    return "\n".join(lines) + "\n"


def _row(trial: SearchTrial, names: list[str]) -> list[str]:
    facts = [
        trial.number,
        f"{trial.cost:.4f}",
        trial.epochs or "",
        trial.about.get("parameters", "diverged"),
    ]
    return [*map(str, facts), *(_text(trial.hyperparameters.get(name, "")) for name in names)]


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)

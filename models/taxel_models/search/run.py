"""Runs and continues a search with SMAC3, and reads its result."""

import json
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from distributed import Client
from smac import HyperparameterOptimizationFacade, MultiFidelityFacade, Scenario
from smac.callback import Callback
from smac.main.smbo import SMBO
from smac.runhistory import StatusType, TrialInfo, TrialValue
from typing_extensions import override

from taxel.errors import ArtifactError, TaxelError
from taxel_models.families.family import FitTask, Progress, unseen
from taxel_models.search.objective import TASK, Objective, hyperparameters_of
from taxel_models.search.search_settings import SearchSettings
from taxel_models.search.spaces import search_space

STATE: Final = "smac"
LOG: Final = "smac.log"


@dataclass(frozen=True)
class SearchTrial:
    """One fit of a search.

    Attributes:
        number: from 1, in the order of starting.
        cost: normalised MAE on the validation set.
        epochs: budget of a network.
        seconds: duration.
        hyperparameters: the configuration, as the family's hyperparameters.
        about: the model's number of parameters and best step, or why the fit diverged.
    """

    number: int
    config_id: int
    cost: float
    epochs: int | None
    seconds: float
    hyperparameters: dict[str, Any]
    about: dict[str, Any]


@dataclass(frozen=True)
class Outcome:
    """What a search found.

    Attributes:
        trials: the finished ones, in the order of starting.
        incumbents: for each change of the best: the number of finished trials, and its cost.
        winner: the incumbent's trial with the largest budget.
    """

    trials: tuple[SearchTrial, ...]
    incumbents: tuple[tuple[int, float], ...]
    winner: SearchTrial

    def best(self, count: int) -> list[SearchTrial]:
        """The best trials, those with more epochs first; a configuration counts once."""
        ordered = sorted(self.trials, key=lambda trial: (-(trial.epochs or 0), trial.cost))
        first = {trial.config_id: trial for trial in reversed(ordered)}
        return sorted(first.values(), key=lambda trial: (-(trial.epochs or 0), trial.cost))[:count]


class _Scenario(Scenario):  # type: ignore[misc]
    """A scenario that continues whatever its folder holds: `SearchSettings.keep` has compared the settings.

    SMAC would ask on the terminal if the folder or the code had moved.
    """

    @override
    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scenario)

    __hash__ = None  # type: ignore[assignment]


class _Watch(Callback):  # type: ignore[misc]
    """Reports progress, and stops the search at a fault that is not the configuration's."""

    def __init__(self, progress: Progress, trials: int) -> None:
        self._progress = progress
        self._trials = trials
        self._best = float("inf")

    @override
    def on_tell_end(self, smbo: SMBO, info: TrialInfo, value: TrialValue) -> None:
        if value.status == StatusType.CRASHED:
            raise TaxelError(f"a trial failed: {value.additional_info['traceback']}")
        self._best = min(self._best, value.cost)
        done = smbo.runhistory.finished
        self._progress(done / self._trials, f"{done} of {self._trials} trials, best {self._best:.4f}")


def search(
    settings: SearchSettings,
    task: FitTask,
    folder: Path,
    *,
    client: Client | None = None,
    progress: Progress = unseen,
) -> Outcome:
    """Run a search in its folder, or continue the one there. A finished search is only read.

    Networks are searched with Hyperband with epochs as budget, XGBoost with full fits, as in the paper.

    Args:
        client: client of the Dask cluster that fits; None fits in this process.

    Raises:
        SettingsError: the folder holds another search.
        ArtifactError: its state is damaged.
        TaxelError: a trial failed, or none has finished.
    """
    settings.keep(folder)
    space = search_space(settings.family)
    scenario = _Scenario(
        configspace=space.build(frozenset(settings.held)),
        name=STATE,
        output_directory=folder,
        deterministic=True,
        n_trials=settings.trials,
        walltime_limit=settings.walltime_s if settings.walltime_s is not None else float("inf"),
        min_budget=settings.least_epochs if space.by_epochs else None,
        max_budget=settings.epochs if space.by_epochs else None,
        seed=settings.seed,
    )
    facade = MultiFidelityFacade if space.by_epochs else HyperparameterOptimizationFacade
    with _logged_to(folder / LOG), warnings.catch_warnings():
        # SMAC averages the times of its local searches for its log, even if there was none.
        for text in ("Mean of empty slice", "invalid value encountered in scalar divide"):
            warnings.filterwarnings("ignore", message=text, category=RuntimeWarning)
        try:
            smac = facade(
                scenario,
                Objective(settings, task if client is None else None).cost,
                logging_level=False,
                callbacks=[_Watch(progress, settings.trials)],
                dask_client=client,
            )
        except (json.JSONDecodeError, KeyError) as error:
            raise ArtifactError(
                f"{folder / STATE}: damaged ({error!r}); expected SMAC's state: remove it to start again"
            ) from None
        if client is None:
            smac.optimize()
        else:
            with client.as_current():  # SMAC waits for trials with the current client
                smac.optimize(data_to_scatter={TASK: task})
    return _outcome(settings, smac)


def _outcome(settings: SearchSettings, smac: HyperparameterOptimizationFacade) -> Outcome:
    history = smac.runhistory
    trials = tuple(
        SearchTrial(
            number=number,
            config_id=key.config_id,
            cost=value.cost,
            epochs=None if key.budget is None else max(1, round(key.budget)),
            seconds=value.time,
            hyperparameters=hyperparameters_of(settings, history.get_config(key.config_id)),
            about=value.additional_info,
        )
        for number, (key, value) in enumerate(history.items(), start=1)
        if value.status == StatusType.SUCCESS
    )
    if not trials:
        raise TaxelError("no trial has finished: expected a longer walltime; the same command continues")
    winner = history.get_config_id(smac.intensifier.get_incumbent())
    changes = tuple((item.trial, float(item.costs[0])) for item in smac.intensifier.trajectory)
    of_winner = [trial for trial in trials if trial.config_id == winner]
    return Outcome(trials, changes, max(of_winner, key=lambda trial: trial.epochs or 0))


@contextmanager
def _logged_to(path: Path) -> Iterator[None]:
    """Write SMAC's log to a file; otherwise its warnings go to stderr."""
    log = logging.getLogger("smac")
    level, propagate = log.level, log.propagate
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    log.propagate = False
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
        log.propagate = propagate
        handler.close()

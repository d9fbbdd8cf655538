"""Searching with the real SMAC: few trials, small fits."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster

from taxel.errors import ArtifactError, SettingsError, TaxelError, Unavailable
from taxel_models.families.family import FitTask
from taxel_models.families.registry import family, resolve
from taxel_models.search.objective import WORST
from taxel_models.search.run import search
from taxel_models.search.search_settings import SETTINGS_FILE, SearchSettings
from taxel_models.training.cluster import connect

Planned = Callable[..., tuple[SearchSettings, FitTask]]


def test_the_winner_has_the_least_cost_and_the_cost_is_that_of_its_fit(
    planned: Planned, tmp_path: Path
) -> None:
    settings, task = planned()
    outcome = search(settings, task, tmp_path / "search")
    assert len(outcome.trials) == settings.trials
    assert outcome.winner.cost == min(trial.cost for trial in outcome.trials)
    assert outcome.incumbents[-1][1] == outcome.winner.cost
    assert outcome.best(2)[0] == outcome.winner
    assert outcome.winner.hyperparameters["n_estimators"] == 1
    xgb = family("xgb")
    fitted, _ = xgb.fit(task, resolve(xgb, 1, outcome.winner.hyperparameters))
    error = np.abs(fitted.predict(task.validation.windows) - task.validation.channels)
    assert outcome.winner.cost == pytest.approx(float(error.mean()), rel=1e-5)
    assert (tmp_path / "search" / "smac.log").stat().st_size


def test_a_search_that_was_stopped_goes_on(planned: Planned, tmp_path: Path) -> None:
    settings, task = planned(trials=5)
    done: list[float] = []

    def stop_at_the_third(share: float, note: str) -> None:
        done.append(share)
        if len(done) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search(settings, task, tmp_path / "search", progress=stop_at_the_third)
    later: list[str] = []
    outcome = search(settings, task, tmp_path / "search", progress=lambda _, note: later.append(note))
    assert len(outcome.trials) == 5
    assert [note.split(",")[0] for note in later] == ["4 of 5 trials", "5 of 5 trials"]
    again: list[str] = []
    finished = search(settings, task, tmp_path / "search", progress=lambda _, note: again.append(note))
    assert finished == outcome
    assert not again


def test_networks_are_searched_with_epochs_as_budget(planned: Planned, tmp_path: Path) -> None:
    settings, task = planned("transformer", trials=5, epochs=3, least_epochs=1)
    outcome = search(settings, task, tmp_path / "search")
    assert {trial.epochs for trial in outcome.trials} == {1, 3}
    assert outcome.winner.epochs == 3
    longest = [trial for trial in outcome.trials if trial.epochs == 3]
    assert outcome.winner.cost == min(trial.cost for trial in longest)
    assert "epochs" not in outcome.winner.hyperparameters


def test_a_fit_that_diverges_costs_the_most_and_says_so(planned: Planned, tmp_path: Path) -> None:
    held = {"embedding": 32, "hidden": 64, "layers": 2, "heads": 1, "learning_rate": 1e30}
    settings, task = planned("transformer", trials=1, epochs=1, least_epochs=1, held=held)
    (trial,) = search(settings, task, tmp_path / "search").trials
    assert trial.cost == WORST
    assert "expected a finite one" in trial.about["diverged"]


def test_a_fault_of_the_data_stops_the_search(planned: Planned, tmp_path: Path) -> None:
    settings, task = planned()
    nothing = np.full_like(task.train.channels, np.nan)
    broken = replace(task, train=replace(task.train, channels=nothing))
    with pytest.raises(TaxelError, match="a trial failed"):
        search(settings, broken, tmp_path / "search")


def test_a_folder_of_another_search_is_refused(planned: Planned, tmp_path: Path) -> None:
    settings, task = planned()
    settings.keep(tmp_path / "search")
    other, _ = planned(seed=1)
    with pytest.raises(SettingsError, match="holds a search with seed 0, not 1"):
        search(other, task, tmp_path / "search")
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "mine.txt").write_text("mine")
    with pytest.raises(SettingsError, match="exists already"):
        search(settings, task, tmp_path / "taken")


def test_settings_that_an_earlier_version_wrote_are_the_same(planned: Planned, tmp_path: Path) -> None:
    """The file keeps the key `unit` for what the code calls `grouping`."""
    settings, _ = planned()
    settings.keep(tmp_path)
    written = json.loads((tmp_path / SETTINGS_FILE).read_text(encoding="utf-8"))
    assert written["unit"] == "chunks"
    assert "grouping" not in written
    settings.keep(tmp_path)
    (tmp_path / SETTINGS_FILE).write_text(json.dumps(written | {"unit": "trials"}), encoding="utf-8")
    with pytest.raises(SettingsError, match="grouping 'trials', not 'chunks'"):
        settings.keep(tmp_path)


def test_damaged_state_is_named(planned: Planned, tmp_path: Path) -> None:
    settings, task = planned(trials=2)
    folder = tmp_path / "search"
    search(settings, task, folder)
    (state,) = folder.glob("smac/**/runhistory.json")
    state.write_text("{")
    with pytest.raises(ArtifactError, match="expected SMAC's state"):
        search(settings, task, folder)
    (folder / "search.json").write_text("{}")
    with pytest.raises(ArtifactError, match=r"search\.json"):
        search(settings, task, folder)


def test_trials_run_on_a_cluster_of_two_workers(planned: Planned, tmp_path: Path) -> None:
    settings, task = planned(trials=3)
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path)
        ) as cluster,
        connect(cluster.scheduler_address) as client,
    ):
        outcome = search(settings, task, tmp_path / "search", client=client)
        assert len(client.nthreads()) == 2
    assert len(outcome.trials) == 3
    xgb = family("xgb")
    fitted, _ = xgb.fit(task, resolve(xgb, 1, outcome.winner.hyperparameters))
    error = np.abs(fitted.predict(task.validation.windows) - task.validation.channels)
    assert outcome.winner.cost == pytest.approx(float(error.mean()), rel=1e-5)


def test_a_scheduler_that_is_not_there_is_named() -> None:
    with pytest.raises(Unavailable, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        connect("tcp://127.0.0.1:9", patience_s=0.5)

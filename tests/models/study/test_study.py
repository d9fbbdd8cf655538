"""A small study on the twin: results, resume, files."""

import json
import logging
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

from taxel.errors import SettingsError
from taxel_models.families.family import FitTask
from taxel_models.families.registry import family
from taxel_models.recordings import Recording, read_ruppel
from taxel_models.study.cell import CellResult
from taxel_models.study.fold_data import fold_data
from taxel_models.study.run import Study, compute_here, run_study
from taxel_models.study.store import Store
from taxel_models.study.study_report import describe, write_report
from taxel_models.study.study_settings import PROTOCOLS, StudySettings
from taxel_models.study.study_tables import Table, leak_table, models_table, results_table, windows_table
from taxel_models.study.summary import Summary, leak

Run = Callable[..., Result]
XGB_1 = ("xgb", 1)
XGB = ("--models", "xgb", "--set", "xgb.n_estimators=2", "--set", "xgb.max_depth=3")


def without_times(results: list[CellResult]) -> list[dict[str, object]]:
    """Everything but how long it took, and on how many cores."""
    return [result.model_dump(exclude={"seconds", "jobs"}) for result in results]


@pytest.fixture(scope="module")
def finished(
    twin: Recording, small_settings: StudySettings, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Study, Store, list[CellResult]]:
    study = Study.of(replace(small_settings, protocols=("strict", "paper")), [twin])
    store = Store(tmp_path_factory.mktemp("study") / "out")
    return study, store, run_study(study, store, compute_here, 1)


def test_a_cell_is_what_fitting_by_hand_gives(finished: tuple[Study, Store, list[CellResult]]) -> None:
    study, _, results = finished
    cell = next(
        result for result in results if (result.model, result.combination, result.fold) == ("xgb", 2, 1)
    )
    data = fold_data(study.partitions["strict"], 2, 1)
    kind = family("xgb")
    chosen = kind.hyperparameters.model_validate(study.settings.hyperparameters["xgb", 2])
    fitted, _ = kind.fit(FitTask(data.spec, data.train, data.validation, seed=1, jobs=1), chosen)
    predicted = data.scaler.restore(fitted.predict(data.test.windows)).astype(float)
    off = predicted - data.measured
    np.testing.assert_allclose(cell.test.mae, np.abs(off).mean(axis=0))
    np.testing.assert_allclose(cell.test.rmse, np.sqrt((off**2).mean(axis=0)))
    np.testing.assert_allclose(cell.test.norm_mae, np.abs(off).mean(axis=0) / data.scaler.std)
    assert cell.test.mean("mae", electrodes=True) == pytest.approx(np.abs(off)[:, 2:].mean())
    assert cell.parameters == fitted.parameters
    assert cell.test_measured_temperature is None


def test_the_baseline_is_tested_at_the_mean_temperature_and_at_the_measured(
    finished: tuple[Study, Store, list[CellResult]],
) -> None:
    baselines = [result for result in finished[2] if result.model == "network-b"]
    assert all(result.test_measured_temperature not in (None, result.test) for result in baselines)


def test_a_second_run_computes_nothing(finished: tuple[Study, Store, list[CellResult]]) -> None:
    study, store, results = finished
    computed: list[object] = []
    again = run_study(study, store, lambda _, batches, __: iter(computed.extend(batches) or ()), 1)
    assert (again, computed) == (results, [])


def test_a_damaged_cell_is_computed_again(
    finished: tuple[Study, Store, list[CellResult]], caplog: pytest.LogCaptureFixture
) -> None:
    study, store, results = finished
    path = next((store.folder / "cells").glob("strict-xgb-1-fold1-*.json"))
    path.write_text(path.read_text(encoding="utf-8")[:100], encoding="utf-8")
    with caplog.at_level(logging.WARNING):
        again = run_study(study, store, compute_here, 1)
    assert "computed again" in caplog.text
    assert without_times(again) == without_times(results)


def test_what_is_described_is_what_the_cells_hold(finished: tuple[Study, Store, list[CellResult]]) -> None:
    study, _, results = finished
    figures = describe(study, results)
    strict = figures["protocols"]["strict"]
    folds = [
        result.test.mean("norm_mae")
        for result in results[:12]
        if (result.model, result.combination) == XGB_1
    ]
    entry = next(row for row in strict["results"] if (row["model"], row["combination"]) == XGB_1)
    assert len(folds) == 3
    assert entry["norm_mae"] == {"mean": pytest.approx(np.mean(folds)), "std": pytest.approx(np.std(folds))}
    assert [row["first"] for row in strict["significance"]["windows"]] == ["1", "1"]
    assert [row["group"] for row in strict["significance"]["models"]] == ["1", "2"]
    assert figures["scale"]["reduced"] is True
    worth = {(row["model"], row["combination"]): row["mae"] for row in figures["leak"]}
    assert set(worth) == {*((m, c) for m in ("xgb", "network-b") for c in (1, 2)), ("mean predictor", None)}
    assert worth[XGB_1]["strict"] == entry["mae"]["mean"]
    assert worth[XGB_1]["share"] == pytest.approx(1 - worth[XGB_1]["paper"] / worth[XGB_1]["strict"])


def test_the_report_holds_tables_and_pictures(
    finished: tuple[Study, Store, list[CellResult]], tmp_path: Path
) -> None:
    study, _, results = finished
    study = replace(study, settings=replace(study.settings, protocols=("strict",)))
    write_report(study, results, tmp_path)
    figures = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert figures == json.loads(json.dumps(describe(study, results)))
    text = (tmp_path / "results.md").read_text(encoding="utf-8")
    assert "**a reduced scale**" in text
    assert "`xgb.n_estimators=2`" in text
    mae = figures["protocols"]["strict"]["results"][0]["mae"]
    for name in ("results.md", "results-strict.tex"):
        assert f"{mae['mean']:.3f} ({mae['std']:.3f})" in (tmp_path / name).read_text(encoding="utf-8")
    assert "published &" not in (tmp_path / "results-strict.tex").read_text(encoding="utf-8")
    pictures = [line.split("(")[1].rstrip(")") for line in text.splitlines() if line.startswith("![")]
    assert len(pictures) == 6
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in pictures)


def test_published_values_stand_beside_ours_where_the_data_are_the_papers(
    finished: tuple[Study, Store, list[CellResult]],
) -> None:
    summary = Summary("strict", finished[2])
    results = results_table(summary, published=True)
    assert "xgb 1, published & 1584 & 13.368 (1.340) & 0.150 (0.015)" in results.latex()
    models = models_table(summary, published=True)
    assert "| -7.740 | -9.785 | 0.000 |" in models.markdown()
    windows = windows_table(summary, published=True)
    assert "| -0.859 |  | 0.000 |" in windows.markdown()


def test_a_name_with_a_bar_stays_in_its_cell() -> None:
    table = Table("a", "by a|b", ("model|inputs", "MAE"), (("x|y", "1.0"),))
    assert table.markdown() == "by a\\|b\n\n| model\\|inputs | MAE |\n| --- | ---: |\n| x\\|y | 1.0 |\n"


def test_the_leak_is_told_beside_the_mean_predictor(
    finished: tuple[Study, Store, list[CellResult]],
) -> None:
    strict, paper = (Summary(protocol, finished[2]) for protocol in PROTOCOLS)
    table = leak_table(leak(strict, paper))
    assert [row[0] for row in table.rows][-1] == "mean predictor"
    assert f"{strict.mean_predictor()['mae']['mean']:.3f}" in table.rows[-1]


def test_the_command_prints_and_extends_a_study(twin_csv: Path, tmp_path: Path, taxel_study: Run) -> None:
    common = (
        "--data",
        twin_csv,
        "-o",
        tmp_path / "out",
        "--folds",
        "2",
        "--rows",
        "6000",
        "--jobs",
        "1",
        *XGB,
    )
    first = taxel_study(*common, "--inputs", "1")
    assert first.exit_code == 0, first.output
    assert "a reduced scale" in first.stdout
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "cells").iterdir()}
    second = taxel_study(*common, "--inputs", "1,2", "--json")
    printed = json.loads(second.stdout)
    assert printed["scale"]["rows_used"] == 6000
    assert [row["combination"] for row in printed["protocols"]["strict"]["results"]] == [1, 2]
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


def test_a_killed_study_goes_on(twin_csv: Path, tmp_path: Path) -> None:
    settings = {"n_estimators": 30, "max_depth": 3}
    arguments = [*("--data", twin_csv), *("--folds", "3"), *("--inputs", "1-2"), *("--models", "xgb")]
    arguments += [part for name, value in settings.items() for part in ("--set", f"xgb.{name}={value}")]
    runs = "import typer; from taxel_models.commands.study import study; typer.run(study)"
    out = tmp_path / "out"
    process = subprocess.Popen([sys.executable, "-c", runs, *map(str, arguments), "-o", str(out)])
    while not list(out.glob("cells/*.json")) and process.poll() is None:
        time.sleep(0.005)
    process.kill()
    process.wait()
    kept = {path: path.stat().st_mtime_ns for path in out.glob("cells/*.json")}
    assert 0 < len(kept) < 6

    settings = StudySettings(("xgb",), (1, 2), folds=3, overrides={"xgb": settings})
    study = Study.of(settings, [read_ruppel(twin_csv)])
    resumed = run_study(study, Store(out), compute_here, 1)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert len(list(out.glob("cells/*.json"))) == 6
    whole = run_study(study, Store(tmp_path / "whole"), compute_here, 1)
    assert without_times(resumed) == without_times(whole)


def test_a_place_that_is_no_study_is_refused(twin_csv: Path, tmp_path: Path, taxel_study: Run) -> None:
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    result = taxel_study("--data", twin_csv, "-o", tmp_path, *XGB)
    assert result.exit_code == 2
    assert "no study's folder" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(SettingsError, match="is a file"):
        Store(tmp_path / "mine.txt")

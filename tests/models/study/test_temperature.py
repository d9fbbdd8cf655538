"""Network B told the measured temperature, the mean, and every one that occurs."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

from taxel.errors import SettingsError
from taxel_models.families.family import FitTask
from taxel_models.families.registry import family, resolve
from taxel_models.recordings import Recording
from taxel_models.study.cell import CellResult
from taxel_models.study.fold_data import fold_data
from taxel_models.study.run import Study, compute_here, run_study
from taxel_models.study.store import Store
from taxel_models.study.study_report import describe, write_report
from taxel_models.study.study_settings import SWEPT, StudySettings
from taxel_models.study.summary import Summary
from taxel_models.study.sweep import sweep_temperature
from taxel_models.study.temperature import Temperature, temperature_table

Swept = tuple[Study, Store, list[CellResult]]


@pytest.fixture(scope="module")
def swept(
    twin: Recording, small_settings: StudySettings, tmp_path_factory: pytest.TempPathFactory
) -> Swept:
    study = Study.of(replace(small_settings, combinations=(1,), temperature=True), [twin])
    store = Store(tmp_path_factory.mktemp("swept") / "out")
    return study, store, run_study(study, store, compute_here, 1)


@pytest.fixture(scope="module")
def temperature(swept: Swept) -> Temperature:
    found = Temperature.of(Summary("strict", swept[2]))
    assert found is not None
    return found


def test_each_temperature_is_told_as_the_model_was_fitted(
    swept: Swept, small_settings: StudySettings
) -> None:
    """A Network B's errors in counts, from counts that are z-scored here as its training data were."""
    data = fold_data(swept[0].partitions["strict"], 1, 0)
    few = replace(data, tdc=data.tdc[[0, len(data.tdc) // 2, -1]])
    kind = family("network-b")
    task = FitTask(data.spec, data.train, data.validation, seed=0, jobs=1, extras=("tdc",))
    fitted, _ = kind.fit(task, resolve(kind, 1, small_settings.overrides["network-b"]))
    found = sweep_temperature(few, fitted)
    assert found.tdc == tuple(few.tdc)
    assert found.mean_tdc == data.tdc_scaler.mean[0]
    for tdc, mae, norm_mae in zip(found.tdc, found.mae, found.norm_mae, strict=True):
        told = (tdc - data.tdc_scaler.mean[0]) / data.tdc_scaler.std[0]
        z_scores = fitted.predict(data.test.windows, {"tdc": np.full(len(data.test), told, np.float32)})
        missed = np.abs(z_scores * data.scaler.std + data.scaler.mean - data.measured).mean(axis=0)
        assert mae == pytest.approx(missed.mean(), rel=1e-4)
        assert norm_mae == pytest.approx((missed / data.scaler.std).mean(), rel=1e-4)
    assert len(set(found.norm_mae)) == 3


def test_every_whole_count_that_occurs_is_told(swept: Swept, twin: Recording) -> None:
    results = swept[2]
    sweeps = [result.sweep for result in results if (result.model, result.combination) == SWEPT]
    assert len(sweeps) == 3
    occurring = np.unique(twin.auxiliary["tdc"])
    for sweep in sweeps:
        assert sweep is not None
        assert sweep.tdc == tuple(occurring.tolist())
    assert all(result.sweep is None for result in results if (result.model, result.combination) != SWEPT)


def test_the_curve_passes_through_the_error_at_the_mean(temperature: Temperature) -> None:
    curve = [np.interp(temperature.mean.tdc, temperature.tdc, fold) for fold in temperature.norm_mae]
    np.testing.assert_allclose(curve, temperature.mean.errors.norm_mae, rtol=0.01)


def test_the_best_fixed_temperature_is_the_lowest_of_the_mean_curve(temperature: Temperature) -> None:
    curve = temperature.norm_mae.mean(axis=0)
    assert temperature.best.errors.norm_mae.mean() == curve.min()
    assert temperature.worst.errors.norm_mae.mean() == curve.max()
    assert curve[temperature.tdc == temperature.best.tdc] == curve.min()


def test_the_relative_loss_is_in_shares_of_the_mean_predictors_error(
    temperature: Temperature, swept: Swept
) -> None:
    cells = [cell for cell in swept[2] if (cell.model, cell.combination) == SWEPT]
    parts = ("test_measured_temperature", "test", "mean_predictor")
    measured, fixed, naive = (
        np.mean([getattr(cell, part).mean("norm_mae") for cell in cells]) for part in parts
    )
    assert temperature.relative_loss(temperature.mean) == pytest.approx((fixed - measured) / naive)


def test_it_is_reported(swept: Swept, temperature: Temperature, tmp_path: Path) -> None:
    study, _, results = swept
    write_report(study, results, tmp_path)
    figures = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert figures == json.loads(json.dumps(describe(study, results)))
    told = figures["protocols"]["strict"]["temperature"]
    assert told["best"]["tdc"] == temperature.best.tdc
    assert told["best"]["norm_mae"]["mean"] == min(told["sweep"]["norm_mae"])
    assert len(told["sweep"]["tdc"]) == len(told["sweep"]["norm_mae_std"])
    text = (tmp_path / "results.md").read_text(encoding="utf-8")
    assert temperature_table(temperature, published=False).markdown().strip() in text
    assert "(temperature-strict.png)" in text
    assert (tmp_path / "temperature-strict.png").read_bytes().startswith(b"\x89PNG")
    assert "best fixed" in (tmp_path / "temperature-strict.tex").read_text(encoding="utf-8")


def test_published_figures_stand_beside_ours_where_the_data_are_the_papers(
    temperature: Temperature,
) -> None:
    table = temperature_table(temperature, published=True)
    assert [row[-1] for row in table.rows] == ["0.096", "0.228", "0.228", "", "0.537"]
    assert "24.4 %" in table.caption
    assert "24.4 %" not in temperature_table(temperature, published=False).caption


def test_swept_cells_are_kept_and_others_are_shared(swept: Swept, twin: Recording) -> None:
    study, store, results = swept
    computed: list[object] = []
    again = run_study(study, store, lambda _, batches, __: iter(computed.extend(batches) or ()), 1)
    assert (again, computed) == (results, [])
    plain = Study.of(replace(study.settings, temperature=False), [twin])
    differ = [cell for cell in study.settings.cells() if study.key(cell) != plain.key(cell)]
    assert [(cell.model, cell.combination) for cell in differ] == [SWEPT] * 3


def test_without_a_sweep_there_is_nothing_to_report(swept: Swept) -> None:
    plain = [result.model_dump(exclude={"sweep"}) for result in swept[2]]
    assert (
        Temperature.of(Summary("strict", [CellResult.model_validate(result) for result in plain])) is None
    )
    xgb = [result for result in swept[2] if result.model == "xgb"]
    assert Temperature.of(Summary("strict", xgb)) is None


def test_a_study_without_network_b_cannot_sweep(
    twin_csv: Path, tmp_path: Path, taxel_study: Callable[..., Result]
) -> None:
    with pytest.raises(SettingsError, match="network-b"):
        StudySettings(models=("network-b",), combinations=(2,), temperature=True)
    result = taxel_study("--data", twin_csv, "-o", tmp_path / "out", "--models", "xgb", "--temperature")
    assert result.exit_code == 2
    assert "--temperature" in result.stderr

"""Training XGBoost: deterministic, without a leak, kept and read back whole."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xgboost

from taxel.channels import CHANNELS
from taxel.errors import ArtifactError, SettingsError
from taxel.windows import WindowSpec
from taxel_models.families.published import published
from taxel_models.families.registry import family, resolve
from taxel_models.recordings import Recording
from taxel_models.training import trained as trained_models
from taxel_models.training.dataset import Dataset
from taxel_models.training.split import SplitSettings
from taxel_models.training.train import TrainingSettings, train

Make = Callable[..., Recording]
SMALL = {"n_estimators": 6, "max_depth": 3, "eta": 0.5, "min_child_weight": 5}


@pytest.fixture
def recording(make_recording: Make) -> Recording:
    return make_recording([400] * 25)


def small_settings(**changes: object) -> TrainingSettings:
    return TrainingSettings(**{"model": "xgb", "combination": 2, "overrides": SMALL, **changes})  # type: ignore[arg-type]


def test_the_same_seed_gives_the_same_model_on_any_number_of_cores(recording: Recording) -> None:
    serial, _ = train([recording], small_settings(jobs=1))
    parallel, _ = train([recording], small_settings(jobs=3))
    assert serial.record == parallel.record
    for first, second in zip(serial.fitted.boosters, parallel.fitted.boosters, strict=True):
        assert first.save_raw("json") == second.save_raw("json")
    other, _ = train([recording], small_settings(seed=1))
    assert other.record.training.metrics != serial.record.training.metrics


def test_it_learns_and_reports_beside_the_mean_predictor(recording: Recording) -> None:
    model, kept = train([recording], small_settings())
    metrics = model.record.training.metrics
    assert metrics["test"]["norm_mae"] < 0.8 * metrics["mean_predictor"]["norm_mae"]
    assert set(metrics["test"]["per_channel"]) == set(CHANNELS)
    data = Dataset.of([recording], model.spec, SplitSettings())
    predicted = model.predict(data.test.windows)
    mae = np.abs(predicted - data.test.channels).mean()
    assert metrics["test"]["mae"] == pytest.approx(mae, rel=1e-6)
    assert sum(map(len, kept.test)) > 0


def test_statistics_come_from_the_training_part_alone(recording: Recording) -> None:
    model, _ = train([recording], small_settings())
    data = Dataset.of([recording], WindowSpec.of(2), SplitSettings())
    normalisation = model.record.normalisation
    np.testing.assert_allclose(normalisation.output_mean, data.train.channels.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(normalisation.output_std, data.train.channels.std(axis=0), rtol=1e-6)
    np.testing.assert_allclose(
        normalisation.input_std, data.train.windows.astype(float).std(axis=0), rtol=1e-5
    )


def test_a_channel_is_what_xgboost_alone_would_fit(recording: Recording) -> None:
    """One channel against XGBRegressor on the same numbers with the same settings."""
    model, _ = train([recording], small_settings(overrides={**SMALL, "early_stopping_rounds": 0}))
    data = Dataset.of([recording], WindowSpec.of(2), SplitSettings())
    normalisation = model.record.normalisation
    scale = lambda values, mean, std: (values - np.float32(mean)) / np.float32(std)  # noqa: E731
    windows = scale(data.train.windows, normalisation.input_mean, normalisation.input_std)
    target = scale(
        data.train.channels[:, 4].astype(np.float32),
        normalisation.output_mean[4],
        normalisation.output_std[4],
    )
    chosen = {**published("xgb", 2), **SMALL}
    peer = xgboost.XGBRegressor(
        objective="reg:absoluteerror", tree_method="hist", random_state=0, n_jobs=1, **chosen
    ).fit(windows, target)
    np.testing.assert_array_equal(model.fitted.predict(windows[:500])[:, 4], peer.predict(windows[:500]))


def test_an_interrupt_ends_every_channel(recording: Recording) -> None:
    """The other worker must not go on with its thousands of trees."""
    notes: list[str] = []

    def interrupt_once(done: float, note: str) -> None:
        notes.append(note)
        if len(notes) == 10:
            raise KeyboardInterrupt

    overrides = {**SMALL, "n_estimators": 3000, "early_stopping_rounds": 0}
    with pytest.raises(KeyboardInterrupt):
        train([recording], small_settings(overrides=overrides, jobs=2), interrupt_once)
    assert len(notes) < 1000


def test_early_stopping_keeps_the_best_trees(recording: Recording) -> None:
    noisy = Recording.of(
        recording.samples.time_ns,
        recording.samples.position,
        recording.samples.force,
        np.random.default_rng(0).normal(size=recording.channels.shape),
        recording.auxiliary,
    )
    settings = small_settings(overrides={**SMALL, "n_estimators": 60, "early_stopping_rounds": 3})
    model, _ = train([noisy], settings)
    assert max(model.record.history.notes["trees"].values()) < 60


def test_a_trained_model_is_kept_whole(recording: Recording, tmp_path: Path) -> None:
    model, kept = train([recording], small_settings())
    folder = tmp_path / "trained"
    trained_models.save(model, kept, folder)
    back = trained_models.load(folder)
    assert back.record == model.record
    windows = np.random.default_rng(0).normal(size=(99, 9)).astype(np.float32)
    np.testing.assert_array_equal(back.predict(windows), model.predict(windows))
    (rows,) = trained_models.held_out(folder)
    np.testing.assert_array_equal(rows.channels, kept.test[0].channels)
    (reference,) = trained_models.reference(folder)
    np.testing.assert_array_equal(reference.channels, kept.reference[0].channels)
    (fitted,) = trained_models.fitted(folder)
    np.testing.assert_array_equal(fitted.channels, kept.fitted[0].channels)
    with pytest.raises(SettingsError, match="exists already"):
        trained_models.save(model, kept, folder)


def test_a_trained_model_of_an_earlier_version_is_judged_by_its_test_rows(
    recording: Recording, tmp_path: Path
) -> None:
    model, kept = train([recording], small_settings())
    folder = tmp_path / "trained"
    trained_models.save(model, kept, folder)
    shutil.rmtree(folder / "reference")
    (rows,) = trained_models.reference(folder)
    np.testing.assert_array_equal(rows.channels, kept.test[0].channels)


def test_damage_to_a_trained_model_is_named(recording: Recording, tmp_path: Path) -> None:
    model, kept = train([recording], small_settings())
    folder = tmp_path / "trained"
    trained_models.save(model, kept, folder)
    (folder / "weights" / "e7.json").write_text("{")
    with pytest.raises(ArtifactError, match=r"e7\.json: not a model that XGBoost reads"):
        trained_models.load(folder)
    record = json.loads((folder / "trained.json").read_text())
    (folder / "trained.json").write_text(json.dumps({**record, "combination": 9}))
    with pytest.raises(ArtifactError, match="combination"):
        trained_models.load(folder)
    with pytest.raises(ArtifactError, match="expected what `taxel train` wrote"):
        trained_models.load(tmp_path / "nowhere")


def test_the_papers_hyperparameters_are_the_default() -> None:
    xgb = family("xgb")
    assert resolve(xgb, 1, {}).model_dump()["n_estimators"] == 972
    assert resolve(xgb, 8, {}).model_dump()["eta"] == 0.04798
    assert resolve(xgb, 8, {"eta": 0.5}).model_dump()["eta"] == 0.5


@pytest.mark.parametrize(
    ("overrides", "message"),
    [({"etaa": 1}, "etaa"), ({"eta": -1}, "eta"), ({"max_depth": "deep"}, "max_depth")],
)
def test_a_bad_hyperparameter_is_named(overrides: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        resolve(family("xgb"), 1, overrides)


def test_an_unknown_family_is_refused() -> None:
    with pytest.raises(SettingsError, match="expected one of xgb, ffnn"):
        family("svm")

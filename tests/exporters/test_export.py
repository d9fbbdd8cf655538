"""A trained model becomes an artifact that predicts the same, or nothing at all."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import typer
import xgboost
from typer.testing import CliRunner

import taxel
from taxel import artifacts
from taxel.errors import ArtifactError, SettingsError
from taxel_exporters import formats
from taxel_exporters.commands import export as command
from taxel_exporters.export import export
from taxel_models.training import trained as trained_models
from taxel_models.training.dataset import examples
from taxel_models.training.split import SplitSettings
from taxel_models.training.train import TrainingSettings, train
from taxel_models.twin import simulate


def test_the_artifact_predicts_what_the_trained_model_does(trained_folder: Path, tmp_path: Path) -> None:
    manifest = export(trained_folder, tmp_path / "repository", name="finger")
    assert (manifest.name, manifest.version) == ("finger", "1")
    assert manifest.parity is not None
    assert manifest.parity.windows > 100
    assert manifest.parity.largest_difference == 0.0
    trained = trained_models.load(trained_folder)
    (held_out,) = trained_models.held_out(trained_folder)
    windows = examples(held_out, trained.spec).windows
    with taxel.load(tmp_path / "repository") as source:
        predictor = source.predictor("finger")
        np.testing.assert_array_equal(predictor.predict(windows), trained.predict(windows))
        assert predictor.manifest == manifest


def test_the_folder_holds_what_the_design_says(trained_folder: Path, tmp_path: Path) -> None:
    manifest = export(trained_folder, tmp_path)
    folder = tmp_path / "xgb" / "1"
    assert {path.name for path in folder.iterdir()} == {"model.json", "manifest.json", "README.md"}
    assert artifacts.read(folder).manifest == manifest
    card = (folder / "README.md").read_text()
    assert "twin" in card
    assert "mean predictor" in card
    booster = xgboost.Booster(model_file=folder / "model.json")
    assert booster.inplace_predict(np.zeros((2, 12), np.float32)).shape == (2, 21)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["xgb"]


def test_too_little_to_know_what_the_model_gets_wrong_anyway_is_told(
    trained_folder: Path, tmp_path: Path
) -> None:
    app = typer.Typer()
    app.command()(command)
    said = CliRunner().invoke(app, [str(trained_folder), "--repository", str(tmp_path)])
    assert said.exit_code == 0, said.output
    assert artifacts.read(tmp_path / "xgb" / "1").manifest.held_out_residual is None
    assert "held out less than 20 s" in said.output


def test_all_that_was_trained_with_tells_what_the_model_gets_wrong_anyway(tmp_path: Path) -> None:
    settings = TrainingSettings("xgb", 1, SplitSettings("chunks"), overrides={"n_estimators": 8})
    folder = tmp_path / "trained"
    trained_models.save(*train([simulate(3_000, 3)], settings), folder)
    found = export(folder, tmp_path / "repository").held_out_residual
    assert found is not None
    parts = (trained_models.reference(folder), trained_models.fitted(folder))
    held_out, fitted = (sum(map(len, recordings)) for recordings in parts)
    assert held_out < found.rows <= held_out + fitted


def test_the_same_training_gives_the_same_artifact(trained_folder: Path, tmp_path: Path) -> None:
    for repository in ("a", "b"):
        export(trained_folder, tmp_path / repository)
    for file in ("model.json", "manifest.json", "README.md"):
        first, second = ((tmp_path / repository / "xgb" / "1" / file).read_bytes() for repository in "ab")
        assert first == second


def test_versions_count_up_and_never_change(trained_folder: Path, tmp_path: Path) -> None:
    assert [export(trained_folder, tmp_path).version for _ in range(2)] == ["1", "2"]
    with pytest.raises(SettingsError, match="versions do not change"):
        export(trained_folder, tmp_path, version="2")


@pytest.mark.parametrize(("name", "version"), [("../up", None), ("a b", None), ("ok", "0"), ("ok", "v1")])
def test_a_bad_name_or_version_is_refused(
    trained_folder: Path, tmp_path: Path, name: str, version: str | None
) -> None:
    with pytest.raises(SettingsError, match="expected"):
        export(trained_folder, tmp_path / "repository", name=name, version=version)
    assert not (tmp_path / "repository").exists()


def test_an_artifact_that_fails_parity_is_not_written(
    trained_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = formats.write

    def with_one_tree_changed(
        trained: trained_models.TrainedModel, model_format: str | None
    ) -> formats.ExportedModel:
        model = original(trained, model_format)
        content = json.loads(model.content)
        tree = content["learner"]["gradient_booster"]["model"]["trees"][0]
        leaves = [node for node, left in enumerate(tree["left_children"]) if left == -1]
        for leaf in leaves:
            tree["split_conditions"][leaf] += 0.5
        changed = json.dumps(content).encode()
        return formats.ExportedModel(
            model.platform, model.file_name, changed, model.folded, model.tolerance
        )

    monkeypatch.setattr(formats, "write", with_one_tree_changed)
    with pytest.raises(ArtifactError, match=r"parity: window \d+, channel pac0: the artifact gives"):
        export(trained_folder, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_trained_model_writes_nothing(trained_folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(trained_folder, copy)
    shutil.rmtree(copy / "held_out")
    with pytest.raises(ArtifactError, match="expected the held-out rows"):
        export(copy, tmp_path / "repository")
    assert not (tmp_path / "repository").exists()

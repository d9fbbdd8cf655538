"""`taxel search`, and `taxel train` with what it found."""

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from taxel.commands.cli import failing_clearly
from taxel.errors import SettingsError
from taxel_models.commands.search import search
from taxel_models.commands.train import train
from taxel_models.recordings import Recording, write_ruppel
from taxel_models.training.hyperparameters import read_hyperparameters


@pytest.fixture(scope="module")
def app() -> typer.Typer:
    app = typer.Typer()
    for command in (search, train):
        app.command()(failing_clearly(command))
    return app


@pytest.fixture(scope="module")
def data(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("data") / "twin.csv"
    write_ruppel(recording, path)
    return path


def test_the_winner_can_be_trained(app: typer.Typer, data: Path, tmp_path: Path) -> None:
    found = tmp_path / "found"
    held = ["--set", "n_estimators=2", "--set", "max_depth=3"]
    common = ["--model", "xgb", "--inputs", "3", "--data", str(data), "--holdout", "chunks", "--jobs", "1"]
    searched = CliRunner().invoke(
        app, ["search", *common, "-o", str(found), "--trials", "3", *held, "--json"]
    )
    assert searched.exit_code == 0, searched.output
    printed = json.loads(searched.stdout)
    assert printed["trials"] == 3
    chosen = printed["hyperparameters"]
    kept = json.loads((found / "hyperparameters.json").read_text())
    assert kept["hyperparameters"] == chosen
    assert kept["origin"]["cost"] == printed["cost"]
    assert (found / "trials.png").read_bytes().startswith(b"\x89PNG")
    assert len(json.loads((found / "trials.json").read_text())) == 3
    assert (found / "best.md").read_text().count("\n| ") == 5

    options = ["--hyperparameters", str(found / "hyperparameters.json"), "--set", "max_depth=2", "--json"]
    trained = CliRunner().invoke(app, ["train", *common, "-o", str(tmp_path / "trained"), *options])
    assert trained.exit_code == 0, trained.output
    used = json.loads(trained.stdout)["training"]["hyperparameters"]
    assert {name: used[name] for name in chosen} == {**chosen, "max_depth": 2}

    wrong = CliRunner().invoke(
        app, ["train", *common[:2], *common[4:], "-o", str(tmp_path / "other"), *options]
    )
    assert wrong.exit_code == 2
    assert "hyperparameters of xgb for inputs 3; expected those of xgb for inputs 1" in wrong.stderr
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file"),
        ("{", "expected what `taxel search` wrote"),
        ('{"family": "xgb", "combination": 1}', "hyperparameters"),
        ('{"family": "ffnn", "combination": 1, "hyperparameters": {}}', "expected those of xgb"),
        ('{"family": "xgb", "combination": 1, "hyperparameters": {"etaa": 1}}', r"found\.json: .*etaa"),
    ],
)
def test_a_file_that_does_not_fit_is_named(content: str | None, message: str, tmp_path: Path) -> None:
    path = tmp_path / "found.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(SettingsError, match=message):
        read_hyperparameters(path, "xgb", 1)

"""`taxel loop` from a recording to a corrected model that is served."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from click.testing import Result
from typer.testing import CliRunner

import taxel
from taxel.commands.cli import failing_clearly
from taxel_exporters import corrected
from taxel_exporters.loop import loop
from taxel_models.loop import residual_model
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.registry import NAMES
from taxel_models.loop.observations import Observations, gather
from taxel_models.recordings import read_recording, write_ruppel
from taxel_models.recovery.injection import Injection
from taxel_models.recovery.injectors import inject
from taxel_models.shipped import shipped_repository
from taxel_models.twin import simulate

MODEL = "network-b"
OFFSET_ALONE = [part for name in NAMES if name != "offset" for part in ("--exclude", name)]
"""For tests in which it does not matter what else might be named."""


@pytest.fixture(scope="module")
def app() -> typer.Typer:
    app = typer.Typer()
    app.command()(failing_clearly(loop))
    return app


@pytest.fixture(scope="module")
def repository(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loop") / "repository"
    shutil.copytree(shipped_repository() / MODEL, folder / MODEL)
    return folder


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute and a half of the twin with offsets twice as large as a good model's error."""
    path = tmp_path_factory.mktemp("loop") / "offset.csv"
    injection = Injection.into(simulate(9_000, 21), 4)
    inject(injection, "offset", 2.0)
    write_ruppel(injection.recording, path)
    return path


def run(app: typer.Typer, repository: Path, data: Path, output: Path, *arguments: str) -> Result:
    options = ["--model", MODEL, "--repository", str(repository), "--data", str(data), "-o", str(output)]
    # The last of an option that is given twice holds.
    return CliRunner().invoke(app, [*options, *arguments])


def evidence_of(repository: Path, data: Path, version: str) -> Observations:
    with taxel.load(repository) as source:
        predictor = source.predictor(MODEL, version)
        recording = read_recording(data)
        return gather(predictor, [recording])


def test_what_is_exported_gives_what_was_reported(
    app: typer.Typer, repository: Path, data: Path, tmp_path: Path
) -> None:
    output = tmp_path / "report"
    result = run(app, repository, data, output, "--export", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found == json.loads((output / "report.json").read_text())
    assert (found["model"], found["exported"]) == (f"{MODEL}/1", f"{MODEL}/2")
    assert found["effects"][0]["name"] == "offset"
    assert found["after"]["norm_mae"] < 0.7 * found["before"]["norm_mae"]
    assert found["test"]["p_value"] < 0.01
    before, after = (evidence_of(repository, data, version) for version in ("1", "2"))
    rows = cut(before, seed=0).evaluation
    assert rows.sum() == found["split"]["evaluation_rows"]
    for observations, errors in ((before, found["before"]), (after, found["after"])):
        own = observations.kept(np.isin(observations.rows[0], before.rows[0][rows]))
        mae = np.abs(own.measured - own.predicted).mean()
        assert mae == pytest.approx(errors["mae"], rel=1e-4)
    # What the corrected model is corrected from is what the first one gives.
    np.testing.assert_allclose(after.base, before.base, atol=0.05)
    again = run(app, repository, data, output)
    assert again.exit_code == 2
    assert "--overwrite" in again.stderr


def test_a_residual_model_is_reported_without_a_name_and_exported(
    app: typer.Typer, repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(residual_model, "COSINES", 64)
    monkeypatch.setattr(residual_model, "COSINES_TRIED", 64)
    recording = simulate(9_000, 21)
    pressed = np.linalg.norm(recording.samples.force, axis=1)
    channels = recording.channels.copy()
    channels[:, 5:12] += (90.0 * np.sin(1.5 * pressed))[:, None]
    path = tmp_path / "bent.csv"
    write_ruppel(replace(recording, channels=np.clip(channels, 0, 4095)), path)
    excluded = [argument for name in NAMES for argument in ("--exclude", name)]
    output = tmp_path / "report"
    result = run(
        app,
        repository,
        path,
        output,
        "--residual-model",
        "--export",
        "--json",
        "--model",
        f"{MODEL}/1",
        *excluded,
    )
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    # A bend in the force is about steady within a touch. Offsets of contacts are reported, not served.
    assert {effect["name"] for effect in found["effects"]} <= {"offset:contact"}
    told = found["residual_model"]
    assert {gain["channel"] for gain in told["channels"]} >= {f"e{number}" for number in range(4, 11)}
    assert all(gain["folds"] > 2 * gain["error"] for gain in told["channels"])
    assert found["after"]["norm_mae"] == pytest.approx(found["before"]["norm_mae"] - told["gain"])
    assert "Unnamed: a residual model" in (output / "report.md").read_text()
    with taxel.load(repository) as source:
        manifest = source.predictor(*found["exported"].split("/")).manifest
    (effect,) = manifest.effects
    assert effect.name == residual_model.NAME
    assert manifest.parity is not None
    assert manifest.parity.largest_difference < 0.01


def test_a_report_outlives_an_export_that_fails(
    app: typer.Typer, repository: Path, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(corrected, "TOLERANCE", -1.0)
    before = sorted(path.name for path in (repository / MODEL).iterdir())
    result = run(
        app, repository, data, tmp_path / "report", "--export", "--model", f"{MODEL}/1", *OFFSET_ALONE
    )
    assert result.exit_code == 1, result.output
    assert "parity: window" in result.stderr
    found = json.loads((tmp_path / "report" / "report.json").read_text())
    assert found["effects"]
    assert found["exported"] is None
    assert sorted(path.name for path in (repository / MODEL).iterdir()) == before


def test_it_says_that_there_was_nothing_to_export(
    app: typer.Typer, repository: Path, data: Path, tmp_path: Path
) -> None:
    result = run(
        app, repository, data, tmp_path / "report", "--export", "--least-share", "1", *OFFSET_ALONE
    )
    assert result.exit_code == 0, result.output
    assert "Exported nothing" in result.stdout


def test_a_correction_that_makes_it_worse_is_not_exported(
    app: typer.Typer, repository: Path, tmp_path: Path
) -> None:
    """The blocks of the evaluation part are off to the other side."""
    recording, path = simulate(9_000, 21), tmp_path / "other_side.csv"
    write_ruppel(recording, path)
    observations = evidence_of(repository, path, "1")
    blocks, channels = cut(observations, seed=0), recording.channels.copy()
    channels[observations.rows[0][blocks.fit]] += 100.0
    channels[observations.rows[0][blocks.evaluation]] -= 100.0
    write_ruppel(replace(recording, channels=np.clip(channels, 0, 4095)), path)
    versions = sorted(folder.name for folder in (repository / MODEL).iterdir())
    output = tmp_path / "report"
    arguments = (*OFFSET_ALONE, "--export", "--stability", "0", "--model", f"{MODEL}/1")
    result = run(app, repository, path, output, *arguments)
    assert result.exit_code == 0, result.output
    found = json.loads((output / "report.json").read_text())
    assert [effect["name"] for effect in found["effects"]] == ["offset"]
    assert found["effects"][0]["served"]
    assert found["after"]["norm_mae"] > found["before"]["norm_mae"]
    assert "Exported nothing: on blocks that nothing was fitted to" in result.stdout
    assert found["exported"] is None
    assert "would make it worse" in (output / "report.md").read_text()
    assert sorted(folder.name for folder in (repository / MODEL).iterdir()) == versions


def test_recordings_that_are_too_short_are_refused(
    app: typer.Typer, repository: Path, tmp_path: Path
) -> None:
    for rows, message in ((15, "no whole window"), (700, "680 rows make 7 blocks: expected at least 16")):
        short = tmp_path / f"{rows}.csv"
        write_ruppel(simulate(rows, 1), short)
        result = run(app, repository, short, tmp_path / "report")
        assert result.exit_code == 1, result.output
        assert message in result.stderr
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--hold-out-by", "mood"], 1, "no covariate 'mood' to hold out by; the recordings have: tac, tdc"),
        (["--model", "nobody"], 1, "nobody"),
        (["--model", f"{MODEL}/7"], 1, "no version '7'"),
        (["--temperature", "warm"], 2, "--temperature warm: expected measured or mean"),
        (["--exclude", "wear"], 2, "no effect 'wear': expected one of offset"),
        (["--held-out", "0.9"], 2, "held-out"),
        (["--calibration", "100"], 2, "calibration"),
        (["--calibration", "60", "--hold-out-by", "mood"], 1, "no covariate 'mood'"),
    ],
)
def test_bad_use_is_refused(
    app: typer.Typer,
    repository: Path,
    data: Path,
    tmp_path: Path,
    arguments: list[str],
    code: int,
    message: str,
) -> None:
    result = run(app, repository, data, tmp_path / "report", *arguments)
    assert result.exit_code == code, result.output
    assert message in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_something_else_than_a_report_is_not_replaced(
    app: typer.Typer, repository: Path, data: Path, tmp_path: Path
) -> None:
    output = tmp_path / "mine"
    output.mkdir()
    (output / "thesis.txt").write_text("years of work")
    result = run(app, repository, data, output, "--overwrite")
    assert result.exit_code == 2
    assert (output / "thesis.txt").read_text() == "years of work"

"""`taxel loop-trial` from the command line."""

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from taxel.commands.cli import failing_clearly
from taxel_models.commands.loop_trial import loop_trial


@pytest.fixture
def app() -> typer.Typer:
    app = typer.Typer()
    app.command()(failing_clearly(loop_trial))
    return app


def test_rounds_are_kept_and_drawn(app: typer.Typer, tmp_path: Path) -> None:
    output, plots = tmp_path / "rounds.json", tmp_path / "plots"
    only = ["--injector", "foreign", "--only", "gain", "--clean", "0", "--unknown", "0"]
    drawn = [*only, "--strength", "1.5", "2"]
    common = ["--trials", "1", "--seed", "3", "--rows", "5000", "-o", str(output), "--plots", str(plots)]
    result = CliRunner().invoke(app, [*common, *drawn])
    assert result.exit_code == 0, result.output
    assert "right effect first" in result.stdout
    assert "95 % interval" in result.stdout
    kept = json.loads(output.read_text())
    (one,) = kept["rounds"]
    assert one["truth"].startswith("gain")
    assert (one["number"], one["ground"], one["injector"]) == (0, "twin", "foreign")
    assert 1.5 <= one["strength"] <= 2
    assert "reached" in one["planted"]
    assert kept["summary"]["rates"]["right_first"]["rounds"] == 1
    assert {path.name for path in plots.iterdir()} == {"confusion.png", "power.png"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--ground", "slide"], "--ground slide: expected --data, the folder of the real recordings"),
        (
            ["--one-of", "material"],
            "--one-of material: only --ground slide has kinds; this is --ground twin",
        ),
        (["--all-days"], "--all-days: only --ground slide has days, and not with --one-of"),
        (["--unseen"], "--unseen: only --ground slide has kinds; this is --ground twin"),
        (["--models", "3"], "--models 3: twins have one model, that of --model"),
        (["--ground", "lasa", "--data", "nowhere"], "nowhere/lasa_contact: no such folder"),
        (["--injector", "foreign", "--only", "wear"], "no cause wear: expected one of contact offset"),
        (["--strength", "2", "1"], "strengths 2 to 1: expected two above 0"),
    ],
)
def test_what_cannot_be_played_is_refused(
    app: typer.Typer, options: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("TAXEL_DATA", raising=False)
    result = CliRunner().invoke(app, ["--trials", "1", *options])
    assert result.exit_code != 0
    assert message in " ".join(result.output.split())

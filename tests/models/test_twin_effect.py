"""`taxel twin --effect`: what is injected is told in the truth file and nowhere else."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from click.testing import Result
from typer.testing import CliRunner

from taxel.commands.cli import failing_clearly
from taxel_models.commands.twin import twin
from taxel_models.recordings import read_ruppel, write_ruppel
from taxel_models.twin import simulate

ROWS = 3000


@pytest.fixture(scope="module")
def app() -> typer.Typer:
    app = typer.Typer()
    app.command()(failing_clearly(twin))
    return app


def run(app: typer.Typer, output: Path, *arguments: str) -> Result:
    return CliRunner().invoke(app, ["-o", str(output), "--rows", str(ROWS), "--seed", "3", *arguments])


def test_the_file_has_no_trace_of_what_the_truth_tells(app: typer.Typer, tmp_path: Path) -> None:
    plain, effect = tmp_path / "plain.csv", tmp_path / "effect.csv"
    assert run(app, plain).exit_code == 0
    result = run(app, effect, "--effect", "creep:2", "--effect", "offset", "--json")
    assert result.exit_code == 0, result.output
    assert "creep" not in result.stdout
    assert not (tmp_path / "plain.csv.truth.json").exists()
    header, other = (path.read_text().splitlines()[0] for path in (plain, effect))
    assert header == other
    truth = json.loads((tmp_path / "effect.csv.truth.json").read_text())
    assert truth["seed"] == 3
    assert [(effect["name"], effect["strength"]) for effect in truth["effects"]] == [
        ("creep", 2.0),
        ("offset", 1.0),
    ]
    tau = truth["effects"][0]["parameters"]["time_constant"]
    assert 0.3 <= tau <= 10.0
    before, after = read_ruppel(plain), read_ruppel(effect)
    np.testing.assert_array_equal(after.samples.force, before.samples.force)
    np.testing.assert_array_equal(after.auxiliary["tdc"], before.auxiliary["tdc"])
    change = (after.channels - before.channels) / (0.1 * before.channels.std(axis=0))
    assert np.sqrt((change**2).mean()) == pytest.approx(np.sqrt(2.0**2 + 1.0), rel=0.2)


def test_a_seed_says_everything(app: typer.Typer, tmp_path: Path) -> None:
    first, again = tmp_path / "first.csv", tmp_path / "again.csv"
    truths = [tmp_path / "first.json", tmp_path / "again.json"]
    for path, truth in zip((first, again), truths, strict=True):
        result = run(app, path, "--effect", "gain", "--effect", "frame:0.5", "--truth", str(truth))
        assert result.exit_code == 0, result.output
    assert first.read_bytes() == again.read_bytes()
    assert truths[0].read_bytes() == truths[1].read_bytes()
    assert not (tmp_path / "first.csv.truth.json").exists()


def test_covariates_are_injected_into_a_recording_that_has_them(app: typer.Typer, tmp_path: Path) -> None:
    own, output = tmp_path / "own.csv", tmp_path / "injected.csv"
    material = np.repeat(np.arange(6.0), ROWS // 6)
    recording = replace(simulate(ROWS, 5), covariates={"material": material})
    write_ruppel(recording, own)
    result = run(app, output, "--into", str(own), "--effect", "covariate:material:3")
    assert result.exit_code == 0, result.output
    found = read_ruppel(output)
    np.testing.assert_array_equal(found.covariates["material"], material)
    change = found.channels - recording.channels
    unclipped = (found.channels > 0) & (found.channels < 4095)
    for kind in range(6):
        rows = material == kind
        ranges = [np.ptp(change[rows, c][unclipped[rows, c]]) for c in range(21)]
        assert max(ranges) == 0
    truth = json.loads((tmp_path / "injected.csv.truth.json").read_text())
    (effect,) = truth["effects"]
    assert (effect["name"], effect["strength"]) == ("covariate:material", 3.0)
    assert np.shape(effect["parameters"]["weight"]) == (6, 21)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--effect", "wear"], "no effect 'wear': expected one of offset"),
        (["--effect", "gain:0"], "--effect gain:0: expected NAME or NAME:STRENGTH, a strength above 0"),
        (["--effect", "gain:-1"], "a strength above 0"),
        (["--effect", "gain:nan"], "a strength above 0"),
        (["--effect", "gain:inf"], "a strength above 0"),
        (["--effect", "2"], "expected NAME or NAME:STRENGTH"),
        (["--effect", "covariate:material"], "no column 'material' to inject by; the recording has: none"),
        (["--into", "here.csv"], "--into: expected --effect, something to inject"),
        (["--truth", "truth.json"], "--truth: expected --effect as well"),
    ],
)
def test_bad_use_is_refused(app: typer.Typer, tmp_path: Path, arguments: list[str], message: str) -> None:
    result = run(app, tmp_path / "twin.csv", *arguments)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert list(tmp_path.iterdir()) == []

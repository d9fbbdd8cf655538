"""`bench choice`: all models at the same moments, with their delay and their error."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import taxel
from taxel_bench.commands import app
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.recordings import write_ruppel
from taxel_models.shipped import shipped_repository
from taxel_models.training.dataset import examples
from taxel_models.twin import simulate

RECORDING = simulate(3000, 77)


def bench_choice(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["choice", *map(str, arguments)])


@pytest.fixture
def two_models(tmp_path: Path) -> Path:
    for name in ("network-b", "network-b-causal"):
        shutil.copytree(shipped_repository() / name, tmp_path / "repository" / name)
    return tmp_path / "repository"


def test_error_and_delay_are_those_of_the_models(two_models: Path, tmp_path: Path) -> None:
    data, output = tmp_path / "unseen.csv", tmp_path / "choice"
    write_ruppel(RECORDING, data)
    few = ("--repository", two_models, "--data", data, "--repetitions", 10, "-o", output)
    done = bench_choice(*few, "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said == json.loads((output / "choice.json").read_text())
    late, causal = said["models"]
    assert (late["model"], late["delay_ms"], late["warm_up_ms"]) == ("network-b/1", 100.0, 200.0)
    assert (causal["model"], causal["delay_ms"], causal["warm_up_ms"]) == ("network-b-causal/1", 0.0, 100.0)
    with taxel.load(two_models) as models:
        predictor = models.predictor("network-b-causal")
        found = examples(RECORDING, predictor.window)
        # The model that looks ahead has no window for the last ten moments.
        errors = ErrorMetrics.of(
            found.channels[:-10],
            predictor.predict(found.windows[:-10]),
            predictor.manifest.normalisation.output_std,
        )
    assert causal["norm_mae"] == pytest.approx(errors.norm_mae)
    assert min(each["median_us"] for each in said["models"]) > 0
    table = (output / "choice.md").read_text().splitlines()
    assert [line.split(" | ")[0] for line in table[2:]] == ["| `network-b-causal/1`", "| `network-b/1`"]
    assert (output / "choice.png").read_bytes().startswith(b"\x89PNG")


def test_what_cannot_be_compared_is_said(two_models: Path, tmp_path: Path) -> None:
    data = tmp_path / "short.csv"
    write_ruppel(RECORDING.rows(np.arange(15)), data)
    done = bench_choice("--repository", two_models, "--data", data, "-o", tmp_path / "choice")
    assert done.exit_code == 2
    assert "no moment has a window of every model" in done.output
    (tmp_path / "empty").mkdir()
    done = bench_choice("--repository", tmp_path / "empty", "--data", data, "-o", tmp_path / "choice")
    assert done.exit_code == 2
    assert "no model can be loaded" in done.output

"""The main job through its own commands: twin, train, export, serve, predict, bench."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from taxel.channels import CHANNELS
from taxel_bench.server_process import running_server

SMALL = ["--set", "n_estimators=5", "--set", "max_depth=3", "--set", "eta=0.5"]


def taxel(*arguments: str | Path, code: int = 0, module: str = "taxel") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", module, *map(str, arguments)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=120, env={**os.environ, "COLUMNS": "200"}
    )
    assert done.returncode == code, done.stderr
    return done


def as_json(*arguments: str | Path, module: str = "taxel") -> dict[str, Any]:
    result: dict[str, Any] = json.loads(taxel(*arguments, "--json", module=module).stdout)
    return result


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a recording was simulated, a model trained and exported."""
    folder = tmp_path_factory.mktemp("main_job")
    taxel("twin", "--rows", "6000", "--seed", "7", "-o", folder / "twin.csv")
    taxel("train", "--model", "xgb", "--data", folder / "twin.csv", "-o", folder / "trained", *SMALL)
    taxel("export", folder / "trained", "--repository", folder / "repository", "--name", "finger")
    return folder


def test_predictions_through_a_server_equal_those_in_process(work: Path, tmp_path: Path) -> None:
    (held_out,) = (work / "trained" / "held_out").iterdir()
    with running_server(work / "repository") as endpoint:
        served = ["--model", "finger/1", "--connect", endpoint]
        remote = as_json("predict", *served, held_out, "-o", tmp_path / "a.csv")
        assert as_json("models", "--connect", endpoint)["models"][0]["state"] == "READY"
    in_process = ["--model", "finger", "--repository", work / "repository"]
    local = as_json("predict", *in_process, held_out, "-o", tmp_path / "b.csv")
    assert remote == local
    assert set(remote) == {"mae", "norm_mae", "mae_electrodes", "norm_mae_electrodes", "rows", "still"}
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    trained = json.loads((work / "trained" / "trained.json").read_text())
    assert remote["norm_mae"] == pytest.approx(trained["training"]["metrics"]["test"]["norm_mae"], rel=1e-6)
    rows = list(csv.reader((tmp_path / "a.csv").read_text().splitlines()))
    assert rows[0] == ["time_ns", *CHANNELS]
    assert len(rows) - 1 == remote["rows"]


def test_contacts_without_measurements_are_predicted_too(work: Path, tmp_path: Path) -> None:
    """A CSV file of the seven input columns alone gives the same predictions."""
    (held_out,) = (work / "trained" / "held_out").iterdir()
    rows = list(csv.reader(held_out.read_text().splitlines()))
    contacts = tmp_path / "contacts.csv"
    with contacts.open("w", newline="") as file:
        csv.writer(file).writerows(row[:7] for row in rows)
    for name, recording in (("whole", held_out), ("contacts", contacts)):
        model = ["--model", "finger", "--repository", work / "repository"]
        said = as_json("predict", *model, recording, "-o", tmp_path / f"of_{name}.csv")
    assert said == {"rows": len((tmp_path / "of_whole.csv").read_text().splitlines()) - 1}
    assert (tmp_path / "of_whole.csv").read_bytes() == (tmp_path / "of_contacts.csv").read_bytes()


def test_a_report_has_figures_a_table_and_pictures(work: Path, tmp_path: Path) -> None:
    (held_out,) = (work / "trained" / "held_out").iterdir()
    report = tmp_path / "report"
    said = as_json(
        *("predict", "--model", "finger", "--repository", work / "repository", held_out),
        *("-o", tmp_path / "a.csv", "--report", report),
    )
    names = {path.name for path in report.iterdir()}
    assert names == {"errors.json", "errors.md", "errors.png", "traces.png"}
    raw = json.loads((report / "errors.json").read_text())
    assert raw["model"]["norm_mae"] == said["norm_mae"]
    assert set(raw["model"]["per_channel"]) == set(CHANNELS)
    assert all(len(stretch) == len(CHANNELS) for stretch in raw["norm_mae_by_stretch"])
    assert f"{said['norm_mae']:.3f}" in (report / "errors.md").read_text()


def test_the_bench_times_an_artifact(work: Path) -> None:
    folder = work / "repository" / "finger" / "1"
    said = as_json("run", "--model", folder, "--repetitions", "100", "--batch", "1,8", module="taxel_bench")
    assert said["machine"]["cores"] >= 1
    assert [result["batch"] for result in said["results"]] == [1, 1, 8, 8]
    manifest = json.loads((folder / "manifest.json").read_text())
    for result in said["results"]:
        assert result["parameters"] == manifest["parameters"]
        assert 0 < result["median_ms"] <= result["p90_ms"] <= result["p99_ms"]
        assert result["repetitions"] == 100


def test_the_demo_replays_at_100_hz_and_flat_out() -> None:
    said = as_json("demo", "--seconds", "1", "--rows", "400")
    assert set(said["latency"]) == {"100 Hz", "flat out"}
    assert said["latency"]["flat out"]["repetitions"] == 400 - 20
    assert said["norm_mae"] < 0.6


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["predict", "x.csv", "--model", "m", "-o", "o.csv", "--repository", "."], 1, "no model 'm'"),
        (["predict", "x.csv", "--model", "m", "-o", "o.csv"], 1, "no model 'm'; there is: ffnn"),
        (["models", "--connect", "tcp/127.0.0.1:1", "--repository", "."], 2, "not both"),
        (["train", "--data", "nowhere.csv", "-o", "out"], 1, "nowhere.csv"),
        (["train", "--data", "x.csv", "-o", "out", "--inputs", "9"], 2, "--inputs"),
        (["export", "nowhere", "--repository", "r"], 1, "expected what `taxel train` wrote"),
        (["serve", "--repository", "nowhere"], 1, "nowhere"),
        (["models", "--connect", "tcp/127.0.0.1:1"], 1, "no server at tcp/127.0.0.1:1"),
    ],
)
def test_bad_use_is_said_in_one_line(
    arguments: list[str], code: int, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = taxel(*arguments, code=code)
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_training_never_overwrites_unasked(work: Path) -> None:
    before = (work / "trained" / "trained.json").read_bytes()
    done = taxel("train", "--data", work / "twin.csv", "-o", work / "trained", *SMALL, code=2)
    assert "exists already" in done.stderr
    assert (work / "trained" / "trained.json").read_bytes() == before


def test_outputs_are_checked_before_any_work(work: Path, tmp_path: Path) -> None:
    (held_out,) = (work / "trained" / "held_out").iterdir()
    model = ["--model", "finger", "--repository", work / "repository", held_out]
    (tmp_path / "thesis.txt").write_text("years")
    assert "is a folder" in taxel("predict", *model, "-o", tmp_path, code=2).stderr
    done = taxel("predict", *model, "-o", tmp_path / "a.csv", "--report", tmp_path, code=2)
    assert "not ours to replace" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_progress_stays_off_stdout(work: Path) -> None:
    done = taxel("recording", work / "twin.csv", "--json")
    assert json.loads(done.stdout)["rows"] == 6000
    assert done.stderr == ""

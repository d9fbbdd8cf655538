"""`bench run` of corrected models: each in turn with its base, and what the correction costs."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import taxel
from taxel_bench.commands import app
from taxel_bench.subjects.subject import open_subject
from taxel_bench.windows import random_windows

QUICK = ("--repetitions", "20", "--seconds", "0.1")


def results_of(folder: Path, *arguments: str) -> list[dict[str, Any]]:
    done = CliRunner().invoke(app, ["run", "--model", str(folder), *arguments, "--json"])
    assert done.exit_code == 0, done.output
    results: list[dict[str, Any]] = json.loads(done.stdout)["results"]
    return results


def test_its_base_is_timed_beside_it(corrected: Path) -> None:
    results = results_of(corrected, "--batch", "1,8", *QUICK)
    assert [(each["batch"], each["engine"]) for each in results] == [
        *((1, "base"), (1, "taxel"), (8, "base"), (8, "taxel")),
    ]
    for base, ours in (results[:2], results[2:]):
        assert base["how"] == f"{ours['how']}, without effects"
        assert base["repetitions"] == ours["repetitions"] == 20
        for cost, figure in (
            ("correction_cost_us", "warm_median_ms"),
            ("correction_cost_cold_us", "median_ms"),
        ):
            assert ours[cost] == pytest.approx(1e3 * (ours[figure] - base[figure]))
            assert cost not in base
        assert "ratio" not in ours
        assert ours["largest_difference"] is None
        assert base["flops"] == ours["flops"] > 0
        published, windows, operations = ours["notes"]
        assert "without its effects (lag, creep)" in published
        assert windows == "windows: what only the effects take has its default: creep = 0, tdc = 2000"
        assert "without its effects" in operations


def test_both_engines_evaluate_what_they_say(corrected: Path) -> None:
    with open_subject(str(corrected)) as subject, taxel.load(corrected.parents[1]) as source:
        engines: dict[str, Any] = {engine.name: engine for engine in subject.engines}
        windows = random_windows(subject.manifest, 32, seed=3)
        found = {name: engine.predict(windows) for name, engine in engines.items()}
        whole, bare = (source.predictor(corrected.parent.name, version) for version in ("2", "1"))
        np.testing.assert_array_equal(found["taxel"], whole.predict(windows))
        np.testing.assert_array_equal(found["base"], bare.predict(windows[:, :12]))
    assert found["base"].shape == (32, 21)
    np.testing.assert_allclose(found["taxel"] - found["base"], 10.0, atol=0.01)


def test_the_papers_protocol_has_the_cost_by_means(corrected: Path) -> None:
    base, ours = results_of(corrected, "--protocol", "paper", "--repetitions", "20")
    assert (base["engine"], ours["engine"]) == ("base", "taxel")
    difference = 1e3 * (ours["mean_ms"] - base["mean_ms"])
    assert ours["correction_cost_cold_us"] == pytest.approx(difference)
    assert "mean_ms_per_channel" not in base


@pytest.mark.parametrize("protocol", ["serving", "paper"])
def test_people_get_the_cost_in_the_table(corrected: Path, protocol: str) -> None:
    arguments = ["--model", str(corrected), "--protocol", protocol, *QUICK]
    text = CliRunner().invoke(app, ["run", *arguments], env={"COLUMNS": "160"}).stdout
    assert "cost, µs" in text
    assert "ratio" not in text
    (row,) = [line for line in text.splitlines() if "│ taxel" in line]
    costs = [float(cell.replace(",", "")) for cell in row.replace("│", " ").split() if cell[0] in "+-"]
    assert len(costs) == (2 if protocol == "serving" else 1)

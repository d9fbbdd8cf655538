"""`bench run`: both engines on trees and networks, shipped, by path, and at the paper's size."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from taxel.artifacts import folder_of
from taxel.errors import TaxelError
from taxel_bench.agreement import compare_answers
from taxel_bench.commands import app
from taxel_bench.paper_size import PAPER_MODELS
from taxel_bench.subjects.subject import open_subject
from taxel_bench.windows import random_windows
from taxel_exporters.export import export
from taxel_models.families.published import published_mflops
from taxel_models.shipped import shipped_repository

QUICK = ("--repetitions", "4", "--seconds", "0.1")
FIELDS = {
    *("model", "inputs", "size", "trees", "protocol", "engine", "how", "threads", "batch", "repetitions"),
    *("median_ms", "p90_ms", "p99_ms", "cpu_median_ms", "rows_per_s", "parameters", "flops"),
    *("largest_difference", "rounded", "verdict", "reasons", "notes"),
}


def bench(*arguments: str | Path, code: int = 0) -> Result:
    done = CliRunner().invoke(app, list(map(str, arguments)))
    assert done.exit_code == code, done.output
    return done


def results_of(*arguments: str | Path) -> list[dict[str, Any]]:
    said = json.loads(bench("run", *arguments, "--json").stdout)
    assert set(said) == {"machine", "results", "skipped"}
    assert {"cpu", "flags", "cores", "load", "versions"} <= set(said["machine"])
    results: list[dict[str, Any]] = said["results"]
    return results


@pytest.mark.parametrize("model", PAPER_MODELS)
def test_every_shipped_model_is_timed_by_both_engines(model: str) -> None:
    results = results_of("--model", model, "--batch", "1,8", *QUICK)
    assert [(each["batch"], each["engine"]) for each in results] == [
        *((1, "paper"), (1, "taxel"), (8, "paper"), (8, "taxel")),
    ]
    for result in results:
        assert set(result) >= FIELDS
        assert (result["size"], result["inputs"], result["threads"]) == ("shipped", 1, 1)
        assert result["repetitions"] == 4
        assert 0 < result["median_ms"] <= result["p90_ms"] <= result["p99_ms"]
        assert result["rows_per_s"] == pytest.approx(1000 * result["batch"] / result["median_ms"])
        if model == "transformer":
            # Its exporter rearranges the weights: there are none to give to torch.
            assert result["largest_difference"] is None
            assert "compares speed, not values" in result["notes"][0]
        else:
            assert result["notes"] == []
            assert result["largest_difference"] <= (0 if model == "xgb" else 0.01)
        assert result["verdict"] == "INVALID"
        assert result["warm_verdict"] == ("INVALID" if result["warm_reasons"] else "VALID")
        assert "4 queries do not support p99: at least 662 are needed" in result["reasons"]
    paper, taxel = results[:2]
    assert taxel["ratio"] == pytest.approx(paper["median_ms"] / taxel["median_ms"])
    assert taxel["warm_ratio"] == pytest.approx(paper["warm_median_ms"] / taxel["warm_median_ms"])
    assert taxel["predictor_warm_median_ms"] > 0
    assert taxel["ratios"] == {"paper": taxel["ratio"]}
    # A peer is the best only where its answers are known to be the same.
    compared = None if model == "transformer" else "paper"
    assert taxel.get("best_peer") == taxel.get("best_warm_peer") == compared
    assert taxel["evaluator"]
    assert "instruction_set" in taxel
    assert "evaluator" not in paper


def test_the_papers_protocol_has_the_channels_figure_beside_the_whole() -> None:
    paper, taxel = results_of("--model", "xgb", "--protocol", "paper")
    assert paper["repetitions"] == taxel["repetitions"] == 100
    assert paper["mean_ms_per_channel"] == pytest.approx(paper["mean_ms"] / 21)
    assert paper["std_ms"] > 0
    assert "mean_ms_per_channel" not in taxel
    assert taxel["ratio"] == pytest.approx(paper["mean_ms"] / taxel["mean_ms"])


def test_other_inputs_than_the_shipped_ones_mean_the_papers_size() -> None:
    paper, taxel = results_of("--model", "network-b", "--inputs", "3", *QUICK)
    assert paper["size"] == taxel["size"] == "paper"
    assert paper["parameters"] == taxel["parameters"] == 804_014
    assert paper["flops"] / 1e6 == pytest.approx(published_mflops("network-b", 3), rel=0.01)
    assert paper["largest_difference"] < 0.01


def test_a_transformer_of_the_papers_size_is_compared_too() -> None:
    """Its weights come out of the seed again; our graph leaves out what reaches no output."""
    paper, taxel = results_of("--model", "transformer", "--inputs", "8", *QUICK)
    assert 0 <= paper["largest_difference"] < 0.01
    assert taxel["flops"] < paper["flops"]


def test_an_artifact_is_taken_by_its_path(trained_folder: Path, tmp_path: Path) -> None:
    export(trained_folder, tmp_path, name="finger")
    paper, taxel = results_of("--model", tmp_path / "finger" / "1", *QUICK)
    assert (paper["engine"], taxel["engine"]) == ("paper", "taxel")
    assert paper["largest_difference"] == 0


def test_an_artifact_without_a_published_way_is_timed_alone(trained_folder: Path, tmp_path: Path) -> None:
    export(trained_folder, tmp_path, name="finger", model_format="onnx")
    (taxel,) = results_of("--model", tmp_path / "finger" / "1", *QUICK)
    assert taxel["engine"] == "taxel"
    assert taxel["flops"] is None
    assert len(taxel["notes"]) == 2
    assert "ratio" not in taxel


def test_people_get_a_table_and_what_to_know_of_it() -> None:
    text = bench("run", "--model", "ffnn", *QUICK).stdout
    assert "paper" in text
    assert "A shipped model is small" in text
    assert "batch 1, taxel: 4 queries do not support p99" in text


def test_a_published_way_that_disagrees_is_not_compared() -> None:
    with open_subject("ffnn") as subject:
        inputs = np.split(random_windows(subject.manifest, 8, seed=0), 2)
        spoiled = replace(subject.taxel, counts=lambda outputs: outputs + np.float32(1))
        changed = replace(subject, taxel=spoiled)
        with pytest.raises(TaxelError, match="their speed is not compared"):
            compare_answers(changed, changed.engines, inputs)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--model", "nothing"], 1, "no model 'nothing'"),
        (["--model", "nothing", "--size", "paper"], 2, "the paper's size is known of"),
        (["--model", "xgb", "--inputs", "9"], 2, "to 8"),
        (["--model", "xgb", "--batch", "1,x"], 2, "--batch 1,x"),
        (["--model", "xgb", "--batch", "0"], 2, "--batch 0"),
        (["--model", "xgb", "--batch", "8", "--protocol", "paper"], 2, "single windows"),
        (["--model", "xgb", "--inputs", "5", "--size", "shipped"], 2, "takes input combination 1"),
        (["--model", "ffnn", "--trees", "skewed"], 2, "--trees skewed"),
    ],
)
def test_bad_use_is_said(arguments: list[str], code: int, message: str) -> None:
    assert message in bench("run", *arguments, code=code).output


def test_an_artifact_has_its_own_size() -> None:
    folder = folder_of(shipped_repository(), "ffnn")
    done = bench("run", "--model", folder, "--size", "paper", code=2)
    assert "has its own size" in done.output.replace("\n", " ")

"""`bench table`: a quick one, and what it says of the paper's contradictions."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from taxel_bench.commands import app
from taxel_bench.table.cells import published_cell

QUICK = ("--repetitions", "3", "--seconds", "0.1", "--models", "network-b", "--inputs", "3")


def test_a_table_is_written_with_its_plots(tmp_path: Path) -> None:
    output = tmp_path / "table"
    done = CliRunner().invoke(app, ["table", "-o", str(output), "--batch", "1,2", *QUICK, "--json"])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said == json.loads((output / "table.json").read_text())
    assert {path.name for path in output.iterdir()} == {
        *("table.md", "table.json", "time_against_parameters.png", "latency_against_batch.png"),
    }
    measured = [(each["model"], each["inputs"], each["batch"], each["engine"]) for each in said["results"]]
    assert measured == [
        ("network-b", 3, batch, engine) for batch in (1, 2) for engine in ("paper", "taxel")
    ]
    assert all(each["size"] == "paper" for each in said["results"])
    table = (output / "table.md").read_text()
    assert "| network-b | 3 | 804,000 | 804,014 | 0.539 |" in table
    assert "| network-b | 2 |" in table

    again = CliRunner().invoke(app, ["table", "-o", str(output), *QUICK])
    assert again.exit_code == 2


def test_the_published_time_of_trees_is_one_channels() -> None:
    cell = published_cell("xgb", 1)
    assert cell["inference_ms"] == 0.422
    assert cell["inference_ms_all_channels"] == pytest.approx(21 * 0.422)
    assert cell["flops"] is None


@pytest.mark.parametrize(
    ("model", "combination", "consistent"),
    [("ffnn", 1, True), ("ffnn", 2, False), ("transformer", 6, False), ("xgb", 2, True)],
)
def test_contradictions_of_the_paper_are_marked(model: str, combination: int, consistent: bool) -> None:
    assert published_cell(model, combination)["consistent"] is consistent


@pytest.mark.parametrize("arguments", [["--models", "gpt"], ["--inputs", "1,9"], ["--batch", "0"]])
def test_bad_use_is_refused_before_any_work(arguments: list[str], tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["table", "-o", str(tmp_path / "table"), *arguments])
    assert done.exit_code == 2, done.output
    assert not (tmp_path / "table").exists()

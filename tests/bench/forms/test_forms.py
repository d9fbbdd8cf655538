"""`bench forms`: what is left when an evaluator is switched off, and what its absence costs."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from taxel_bench.commands import app
from taxel_bench.forests import ForestShape, write_forest

FIELDS = {"forest", "rows", "without", "evaluator", "repetitions"} | {
    f"{state}_{figure}" for state in ("cold", "warm") for figure in ("ms", "cpu_ms", "cost")
}


def bench_forms(*arguments: str | Path, code: int = 0) -> Result:
    done = CliRunner().invoke(app, ["forms", *map(str, arguments)])
    assert done.exit_code == code, done.output
    return done


@pytest.fixture
def forest(tmp_path: Path) -> Path:
    path = tmp_path / "small.json"
    write_forest(path, ForestShape(trees_per_output=30, leaves=20), seed=1)
    return path


def test_each_absence_is_timed_beside_everything(forest: Path) -> None:
    few = ("--forest", "", "--model", forest, "--batch", "8,300", "--repetitions", 2)
    said = json.loads(bench_forms(*few, "--without", "small_batch,bitset_256", "--json").stdout)
    assert set(said) == {"machine", "instruction_set", "eviction_bytes", "results"}
    results = said["results"]
    assert [(each["rows"], each["without"]) for each in results] == [
        (rows, name) for rows in (8, 300) for name in ("", "small_batch", "bitset_256")
    ]
    for result in results:
        assert set(result) == FIELDS
        assert result["forest"] == str(forest)
        assert min(result["cold_ms"], result["warm_ms"]) > 0
        if not result["without"]:
            assert (result["cold_cost"], result["warm_cost"]) == (0.0, 0.0)


def test_the_only_evaluator_is_replaced_by_the_node_walk(tmp_path: Path) -> None:
    """No other evaluator takes so large a tree, so no timing decides."""
    path = tmp_path / "large.json"
    write_forest(path, ForestShape(outputs=1, trees_per_output=1, leaves=90_000, depth=64), seed=1)
    few = ("--forest", "", "--model", path, "--batch", "1,300", "--repetitions", 2)
    said = json.loads(bench_forms(*few, "--without", "leaf_blocks,bitset_64", "--json").stdout)
    for rows in (1, 300):
        used = {each["without"]: each["evaluator"] for each in said["results"] if each["rows"] == rows}
        assert used == {"": "leaf-blocks", "leaf_blocks": "node-walk", "bitset_64": "leaf-blocks"}


def test_the_table_has_a_column_for_each_switch() -> None:
    shown = bench_forms("--forest", "shipped", "--batch", 1, "--without", "bitset_64", "--repetitions", 2)
    assert "bitset_64" in shown.stdout
    assert "shipped" in shown.stdout


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [("--without", "magic", "next_leaves"), ("--forest", "odd", "skewed"), ("--batch", "0", "1 to")],
)
def test_what_is_not_there_is_refused_by_name(option: str, value: str, says: str) -> None:
    assert says in bench_forms(option, value, code=2).stderr

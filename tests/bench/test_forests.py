"""Forests of the published size."""

from pathlib import Path

import pytest

from taxel.windows import COMBINATIONS, WindowSpec
from taxel_bench.forests import ForestShape, paper_forest, write_forest
from taxel_models.families.published import published, published_parameters


@pytest.mark.parametrize("combination", COMBINATIONS)
def test_their_shape_is_the_published_one(combination: int) -> None:
    shape = paper_forest(combination)
    assert shape.features == WindowSpec.of(combination).length
    assert shape.trees_per_output == published("xgb", combination)["n_estimators"]
    nodes = 21 * shape.trees_per_output * (2 * shape.leaves - 1)
    assert nodes == pytest.approx(published_parameters("xgb", combination), rel=0.02)


def test_a_seed_gives_the_same_file(tmp_path: Path) -> None:
    shape = ForestShape(features=3, trees_per_output=2, leaves=6)
    counts = [write_forest(tmp_path / name, shape, seed) for name, seed in (("a", 4), ("b", 4), ("c", 5))]
    first, same, other = ((tmp_path / name).read_bytes() for name in "abc")
    assert first == same != other
    assert counts[0] == counts[1]
    assert first.count(b'"id"') == 42

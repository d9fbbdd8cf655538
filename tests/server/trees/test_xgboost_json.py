"""What is read from a model file, and what is refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from taxel.errors import ArtifactError
from taxel_server.runtimes.trees.reading.xgboost_json import read_forest

STUMP = (0, 0.25, True, (1.5,), (-2.5,))
Model = Callable[..., dict[str, Any]]
Write = Callable[[dict[str, Any]], Path]


def test_a_forest_stands_in_preorder(model: Model, write: Write) -> None:
    tree = (1, 0.5, False, STUMP, (2, -1.0, True, (7.0,), (8.0,)))
    forest = read_forest(write(model([tree, (3.0,)], base_score="[-1.25E0]")))
    assert (forest.trees, forest.nodes, forest.features) == (2, 8, 6)
    assert forest.roots.tolist() == [0, 7, 8]
    assert forest.right.tolist() == [4, 3, -1, -1, 6, -1, -1, -1]
    assert forest.value.tolist() == [0.5, 0.25, 1.5, -2.5, -1.0, 7.0, 8.0, 3.0]
    assert forest.default_left.tolist()[:2] == [False, True]
    assert forest.base_score.tolist() == [-1.25]


def test_nodes_out_of_reach_are_left_out(model: Model, write: Write) -> None:
    content = model([STUMP])
    tree = content["learner"]["gradient_booster"]["model"]["trees"][0]
    for name in ("left_children", "right_children", "split_indices", "split_conditions", "default_left"):
        tree[name].append(-1)
    tree["split_type"].append(0)
    tree["tree_param"]["num_nodes"] = "4"
    assert read_forest(write(content)).nodes == 3


def _at(content: dict[str, Any], *path: str | int) -> Any:
    part: Any = content
    for key in path:
        part = part[key]
    return part


TREE = ("learner", "gradient_booster", "model", "trees", 1)
PARAM = ("learner", "learner_model_param")


@pytest.mark.parametrize(
    ("place", "key", "value", "says"),
    [
        (("learner", "gradient_booster"), "name", "dart", r"gradient_booster\.name.*gbtree.*'dart'"),
        (("learner", "gradient_booster"), "name", "gblinear", "'gblinear'"),
        (("learner", "objective"), "name", "reg:logistic", r"objective\.name.*'reg:logistic'"),
        (("learner", "gradient_booster", "model"), "trees", [], r"length >= 1.*model\.trees`"),
        (TREE, "left_children", [], "tree 1: left_children has 0 entries: expected 3"),
        (PARAM, "num_class", "3", "num_class"),
        (PARAM, "num_feature", "0", "num_feature"),
        (PARAM, "base_score", "[1.0, 2.0]", "base_score"),
        (PARAM, "base_score", "often", "base_score"),
        (PARAM, "base_score", "[NaN]", "base_score"),
        ((*TREE, "tree_param"), "size_leaf_vector", "21", r"trees\[1\]\.tree_param\.size_leaf_vector"),
        ((*TREE, "tree_param"), "num_nodes", "5", "tree 1: left_children has 3 entries: expected 5"),
        ((*TREE, "split_type"), 0, 1, "categorical"),
        ((*TREE, "left_children"), 0, 3, "tree 1, node 0: a child that is not a node"),
        ((*TREE, "left_children"), 0, -7, "tree 1, node 0: a child that is not a node"),
        ((*TREE, "right_children"), 0, -1, "tree 1, node 0: a node with only one child"),
        ((*TREE, "right_children"), 0, 0, "tree 1, node 0: a node reached twice"),
        ((*TREE, "left_children"), 0, 2, "tree 1, node 2: a node reached twice"),
        ((*TREE, "left_children"), 0, 1.5, r"Expected `int`, got `float` - .*left_children"),
        ((*TREE, "left_children"), 0, 3e9, "left_children"),
        ((*TREE, "split_indices"), 0, 6, "tree 1, node 0: a feature that the model does not have"),
        ((*TREE, "split_conditions"), 0, float("nan"), "tree 1: split_conditions: Expected `float`"),
        (TREE, "left_children", 4, r"Expected `array`, got `int`.*left_children"),
        (TREE, "left_children", ["1"], r"Expected `int`, got `str`.*left_children"),
        (TREE, "left_children", [True], r"Expected `int`, got `bool`.*left_children"),
        (TREE[:-1], 1, {}, r"missing required field `tree_param`.*trees"),
        (TREE[:-2], "tree_info", [0], "tree_info has 1 entries: expected one for each of 2 trees"),
        (TREE[:-2], "tree_info", [0, 1], "tree_info names outputs 0 to 1 of 1"),
    ],
)
def test_what_is_not_supported_is_refused_by_name(
    model: Model, write: Write, place: tuple[str | int, ...], key: str | int, value: Any, says: str
) -> None:
    content = model([STUMP, STUMP])
    _at(content, *place)[key] = value
    path = write(content)
    with pytest.raises(ArtifactError, match=says) as refusal:
        read_forest(path)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize("text", ["", "{", "[1, 2", "{}", '{"learner": [1 2]}', "\x00", '"', '"\\'])
def test_a_damaged_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "model.json"
    path.write_text(text)
    with pytest.raises(ArtifactError, match=r"model\.json"):
        read_forest(path)


NUMBERS = ["1,,2", "1 2", "1-2", "--1", "1e", "+", "Na", "1,2,", ".", '"1"', "null", "NaN"]


@pytest.mark.parametrize("text", NUMBERS)
def test_what_is_no_number_is_refused(model: Model, write: Write, text: str) -> None:
    path = write(model([STUMP]))
    path.write_text(path.read_text().replace("[0.25, 1.5, -2.5]", f"[0.25, 1.5, {text}]"))
    with pytest.raises(ArtifactError, match=r"model\d*\.json: .+"):
        read_forest(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="cannot be read"):
        read_forest(tmp_path / "model.json")


@pytest.mark.parametrize("text", ["[" * 200_000, '{"learner":' * 100_000])
def test_a_file_that_nests_without_end_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "model.json"
    path.write_text(text)
    with pytest.raises(ArtifactError, match=r"model\.json"):
        read_forest(path)


def _bits(values: NDArray[np.float32]) -> Any:
    return np.where(np.isnan(values), np.float32(np.nan), values).view(np.int32).tolist()


def _spelt(number: np.float32, spelling: Callable[[np.float32], str]) -> str:
    return spelling(number) if np.isfinite(number) else f"{'-' if number < 0 else ''}Infinity"


def _leaves(model: Model, folder: Path, tokens: list[str]) -> NDArray[np.float32]:
    """Leaf values as read from these tokens, each the only leaf of a tree."""
    text = json.dumps(model([(float(place),) for place in range(1000, 1000 + len(tokens))]))
    for place, token in enumerate(tokens):
        text = text.replace(f"[{1000.0 + place}]", f"[ {token}\n]")
    path = folder / "model.json"
    path.write_text(text)
    return read_forest(path).value


@given(st.lists(st.floats(width=32, allow_nan=False), min_size=1, max_size=99))
def test_floats_written_in_any_way_are_read_exactly(
    model: Model, tmp_path_factory: pytest.TempPathFactory, numbers: list[float]
) -> None:
    expected = np.array(numbers, dtype=np.float32)
    spellings = (str, lambda number: repr(float(number)), lambda number: f"{float(number):.9E}")
    folder = tmp_path_factory.mktemp("floats")
    for spelling in spellings:
        tokens = [_spelt(number, spelling) for number in expected]
        assert _bits(_leaves(model, folder, tokens)) == _bits(expected)


@pytest.mark.parametrize(
    ("token", "expected"),
    [
        ("16777217", 16777216.0),
        ("16777217.0000000000000000000001", 16777218.0),
        ("16777219", 16777220.0),
        ("16777218.9999999999999999999999", 16777218.0),
        ("1e-46", 0.0),
        ("7.1e-46", 1.401298464324817e-45),
        ("3.4028236e38", np.inf),
    ],
)
def test_a_decimal_is_rounded_once(model: Model, tmp_path: Path, token: str, expected: float) -> None:
    assert _leaves(model, tmp_path, ["1.5", token])[1] == np.float32(expected)

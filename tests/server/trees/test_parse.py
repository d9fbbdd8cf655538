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
from taxel_server.runtimes.trees.decimals import nearest
from taxel_server.runtimes.trees.parse import read_forest
from taxel_server.runtimes.trees.scan import ScannedText

STUMP = (0, 0.25, True, (1.5,), (-2.5,))
Model = Callable[..., dict[str, Any]]
Write = Callable[[dict[str, Any]], Path]


def test_a_forest_stands_in_preorder(model: Model, write: Write) -> None:
    tree = (1, 0.5, False, STUMP, (2, -1.0, True, (7.0,), (8.0,)))
    forest = read_forest(write(model([tree, (3.0,)], base_score="[-1.25E0]")))
    assert (forest.trees, forest.nodes, forest.features) == (2, 8, 6)
    assert forest.roots.tolist() == [0, 7, 8]
    assert forest.left.tolist() == [1, 2, -1, -1, 5, -1, -1, -1]
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
        (("learner", "gradient_booster", "model"), "trees", [], r"model\.trees: .* at least 1 item"),
        (TREE, "left_children", [], r"trees\.1\.left_children.*\[\]"),
        (PARAM, "num_class", "3", "num_class"),
        (PARAM, "num_feature", "0", "num_feature"),
        (PARAM, "base_score", "[1.0, 2.0]", "base_score"),
        (PARAM, "base_score", "often", "base_score"),
        (PARAM, "base_score", "[NaN]", "base_score"),
        ((*TREE, "tree_param"), "size_leaf_vector", "21", r"trees\.1\.tree_param\.size_leaf_vector"),
        ((*TREE, "tree_param"), "num_nodes", "5", "tree 1: left_children has 3 entries: expected 5"),
        ((*TREE, "split_type"), 0, 1, "categorical"),
        ((*TREE, "left_children"), 0, 3, "tree 1, node 0: a child that is not a node"),
        ((*TREE, "left_children"), 0, -7, "tree 1, node 0: a child that is not a node"),
        ((*TREE, "right_children"), 0, -1, "tree 1, node 0: a node with only one child"),
        ((*TREE, "right_children"), 0, 0, "tree 1, node 0: a node reached twice"),
        ((*TREE, "left_children"), 0, 2, "tree 1, node 2: a node reached twice"),
        ((*TREE, "left_children"), 0, 1.5, "left_children holds 1.5: expected 32-bit integers"),
        ((*TREE, "left_children"), 0, 3e9, "left_children holds 3000000000.0: expected 32-bit integers"),
        ((*TREE, "split_indices"), 0, 6, "tree 1, node 0: a feature that the model does not have"),
        ((*TREE, "split_conditions"), 0, float("nan"), "tree 1, node 0: split_conditions is NaN"),
        (TREE, "left_children", 4, r"trees\.1\.left_children"),
        (TREE, "left_children", ["1"], r"trees\.1\.left_children"),
        (TREE, "left_children", [True], r"trees\.1\.left_children"),
        (TREE[:-1], 1, {}, r"trees\.1"),
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


@pytest.mark.parametrize("text", ["1,,2", "1 2", "1-2", "--1", "1e", "+", "Na", "1,2,", "."])
def test_what_is_no_number_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "array.json"
    path.write_text(f"[{text}]")
    with pytest.raises(ArtifactError, match=r"x holds .*: expected a number"):
        ScannedText.of(path).floats([0], "x")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="cannot be read"):
        read_forest(tmp_path / "model.json")


@given(
    st.recursive(
        st.none() | st.booleans() | st.text() | st.lists(st.integers(-(2**31), 2**31 - 1)),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
        max_leaves=12,
    ),
    st.sampled_from([None, 1]),
)
def test_scanning_sets_arrays_aside_and_keeps_the_rest(
    tmp_path_factory: pytest.TempPathFactory, content: Any, indent: int | None
) -> None:
    path = tmp_path_factory.mktemp("scan") / "any.json"
    path.write_text(json.dumps(content, indent=indent))
    scanned = ScannedText.of(path)

    def restore(part: Any) -> Any:
        if isinstance(part, dict):
            return {key: restore(value) for key, value in part.items()}
        if isinstance(part, list) and len(part) == 1 and type(part[0]) is int:
            return scanned.integers(part, "x").tolist()
        return [restore(value) for value in part] if isinstance(part, list) else part

    assert restore(json.loads(scanned.skeleton)) == content


def _bits(values: NDArray[np.float32]) -> list[int]:
    return np.where(np.isnan(values), np.float32(np.nan), values).view(np.int32).tolist()


def _spelt(number: np.float32, spelling: Callable[[np.float32], str]) -> str:
    if np.isnan(number):
        return "NaN"
    return spelling(number) if np.isfinite(number) else f"{'-' if number < 0 else ''}Infinity"


@given(st.lists(st.floats(width=32), min_size=1))
def test_floats_written_in_any_way_are_read_exactly(
    tmp_path_factory: pytest.TempPathFactory, numbers: list[float]
) -> None:
    expected = np.array(numbers, dtype=np.float32)
    path = tmp_path_factory.mktemp("floats") / "floats.json"
    spellings = (str, lambda number: repr(float(number)), lambda number: f"{float(number):.9E}")
    arrays = [[_spelt(number, spelling) for number in expected] for spelling in spellings]
    path.write_text("".join(f"[{' ,'.join(array)}]" for array in arrays))
    scanned = ScannedText.of(path)
    for array in range(3):
        found = scanned.floats([array], "x")
        assert _bits(found) == _bits(expected)


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
def test_a_decimal_is_rounded_once(tmp_path: Path, token: str, expected: float) -> None:
    path = tmp_path / "number.json"
    path.write_text(f"[{token}]")
    assert ScannedText.of(path).floats([0], "x")[0] == np.float32(expected)
    assert nearest(token) == np.float32(expected)

"""Small models to load: trained by XGBoost, or written by hand."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from taxel.manifest import Normalisation

Tree = tuple[Any, ...]
"""A leaf `(value,)`, or a split `(feature, threshold, default_left, left, right)`."""


@pytest.fixture(scope="session")
def raw() -> Callable[..., Normalisation]:
    """A normalisation that leaves the model's inputs and outputs as they are."""

    def make(features: int, outputs: int = 21) -> Normalisation:
        return Normalisation(
            input_mean=(0.0,) * features,
            input_std=(1.0,) * features,
            output_mean=(0.0,) * outputs,
            output_std=(1.0,) * outputs,
            folded=True,
        )

    return make


def _arrays(tree: Tree) -> dict[str, Any]:
    columns: dict[str, list[Any]] = {
        "left_children": [],
        "right_children": [],
        "split_indices": [],
        "split_conditions": [],
        "default_left": [],
        "split_type": [],
        "parents": [],
    }
    pending = [(tree, 2147483647, "")]
    for node, parent, side in pending:
        place = len(columns["parents"])
        leaf = len(node) == 1
        feature, value, default_left, *children = (0, node[0], 0) if leaf else node
        for name, entry in zip(
            columns, (-1, -1, feature, value, int(default_left), 0, parent), strict=True
        ):
            columns[name].append(entry)
        if side:
            columns[side][parent] = place
        pending += zip(children, [place] * 2, ("left_children", "right_children"), strict=False)
    nodes = len(columns["parents"])
    filler = {name: [0.0] * nodes for name in ("base_weights", "loss_changes", "sum_hessian")}
    empty: dict[str, list[Any]] = {
        name: [] for name in ("categories", "categories_nodes", "categories_segments", "categories_sizes")
    }
    return columns | filler | empty


@pytest.fixture(scope="session")
def model() -> Callable[..., dict[str, Any]]:
    """Makes the JSON of a model from nested tuples, one output after another in turn."""

    def make(
        trees: list[Tree], features: int = 6, outputs: int = 1, base_score: str = "0.5"
    ) -> dict[str, Any]:
        written = []
        for identity, tree in enumerate(trees):
            arrays = _arrays(tree)
            param = {
                "num_deleted": "0",
                "num_feature": str(features),
                "num_nodes": str(len(arrays["parents"])),
                "size_leaf_vector": "1",
            }
            written.append(arrays | {"id": identity, "tree_param": param})
        return {
            "learner": {
                "attributes": {},
                "feature_names": [],
                "feature_types": [],
                "gradient_booster": {
                    "model": {
                        "cats": {"enc": [], "feature_segments": [], "sorted_idx": []},
                        "gbtree_model_param": {"num_parallel_tree": "1", "num_trees": str(len(trees))},
                        "iteration_indptr": [0, len(trees)],
                        "tree_info": [tree % outputs for tree in range(len(trees))],
                        "trees": written,
                    },
                    "name": "gbtree",
                },
                "learner_model_param": {
                    "base_score": base_score,
                    "boost_from_average": "1",
                    "num_class": "0",
                    "num_feature": str(features),
                    "num_target": str(outputs),
                },
                "objective": {"name": "reg:squarederror", "reg_loss_param": {"scale_pos_weight": "1"}},
            },
            "version": [3, 2, 0],
        }

    return make


@pytest.fixture
def write(tmp_path: Path) -> Callable[[dict[str, Any]], Path]:
    """Writes a model's JSON to a file of its own."""

    def to_file(content: dict[str, Any]) -> Path:
        path = tmp_path / f"model{len(list(tmp_path.iterdir()))}.json"
        path.write_text(json.dumps(content))
        return path

    return to_file

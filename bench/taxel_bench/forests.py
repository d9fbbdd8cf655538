"""Forests of a given size and shape as XGBoost JSON: no training, so that a benchmark can start at once."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.windows import WindowSpec
from taxel_models.families.published import published, published_parameters

_NO_PARENT: Final = 2147483647
_VERSION: Final = [3, 2, 0]


@dataclass(frozen=True)
class ForestShape:
    """How large a random forest is and how its trees grow.

    Every tree starts as one leaf; a leaf is drawn and split until there are enough. `skew` 0 draws
    among those of least depth, so that trees are even; 1 always splits the newest leaf as long as
    `depth` allows, so that trees are chains; between the two, it is the chance of the latter.

    Attributes:
        features: number of inputs.
        outputs: number of outputs.
        trees_per_output: trees that each output sums.
        leaves: leaves of a tree, on average.
        depth: longest path from the root to a leaf.
        skew: 0 even to 1 chains.
        cuts: different thresholds of a feature, as a histogram of training data would offer.
    """

    features: int = 12
    outputs: int = 21
    trees_per_output: int = 950
    leaves: int = 38
    depth: int = 10
    skew: float = 0.15
    cuts: int = 255


TreeShape = Literal["even", "skewed"]

_SKEWED: Final = ForestShape(trees_per_output=63, leaves=572, depth=64, skew=0.5)
"""1.5 million nodes in deep trees of some 1,100 each, as unlimited depth grows them."""


def tree_shape(trees: TreeShape, combination: int) -> ForestShape:
    """Even trees as the published forests of a combination have them, or skewed ones, as many nodes."""
    if trees == "even":
        return paper_forest(combination)
    return replace(_SKEWED, features=WindowSpec.of(combination).length)


def paper_forest(combination: int) -> ForestShape:
    """As many trees, as deep, and in the mean as large as the published forests of a combination."""
    chosen = published("xgb", combination)
    trees = len(CHANNELS) * chosen["n_estimators"]
    nodes = published_parameters("xgb", combination) / trees
    return ForestShape(
        features=WindowSpec.of(combination).length,
        outputs=len(CHANNELS),
        trees_per_output=chosen["n_estimators"],
        leaves=round((nodes + 1) / 2),
        depth=chosen["max_depth"],
    )


def write_forest(path: Path, shape: ForestShape, seed: int = 0) -> int:
    """Write a random forest that both XGBoost and the trees runtime load; its number of nodes."""
    generator = np.random.default_rng(seed)
    cuts = np.sort(generator.standard_normal((shape.features, shape.cuts)).astype(np.float32), axis=1)
    trees = [
        _tree(identity, shape, cuts, generator)
        for identity in range(shape.outputs * shape.trees_per_output)
    ]
    path.write_text(json.dumps(_model(shape, trees), separators=(",", ":")))
    return sum(len(tree["left_children"]) for tree in trees)


def _tree(
    identity: int, shape: ForestShape, cuts: NDArray[np.float32], generator: np.random.Generator
) -> dict[str, Any]:
    margin = max(1, shape.leaves // 4)
    leaves = min(int(generator.integers(shape.leaves - margin, shape.leaves + margin + 1)), 2**shape.depth)
    left, right, parent = _grow(max(1, leaves), shape, generator)
    nodes = len(left)
    inner = np.array(left) >= 0
    feature = np.where(inner, generator.integers(0, shape.features, nodes), 0)
    threshold = cuts[feature, generator.integers(0, shape.cuts, nodes)]
    leaf = generator.standard_normal(nodes).astype(np.float32) / np.float32(10)
    value = [_shortest(number) for number in np.where(inner, threshold, leaf)]
    return {
        "base_weights": [0.0] * nodes,
        "categories": [],
        "categories_nodes": [],
        "categories_segments": [],
        "categories_sizes": [],
        "default_left": (generator.random(nodes) < 0.5).astype(int).tolist(),
        "id": identity,
        "left_children": left,
        "loss_changes": [0.0] * nodes,
        "parents": parent,
        "right_children": right,
        "split_conditions": value,
        "split_indices": feature.tolist(),
        "split_type": [0] * nodes,
        "sum_hessian": [0.0] * nodes,
        "tree_param": {
            "num_deleted": "0",
            "num_feature": str(shape.features),
            "num_nodes": str(nodes),
            "size_leaf_vector": "1",
        },
    }


def _grow(
    leaves: int, shape: ForestShape, generator: np.random.Generator
) -> tuple[list[int], list[int], list[int]]:
    """Left children, right children and parents of a random tree with so many leaves."""
    left, right, parent, depth = [-1], [-1], [_NO_PARENT], [0]
    open_leaves = [0]
    choices = generator.random((leaves, 2))
    for chance, side in choices[: leaves - 1].tolist():
        place = len(open_leaves) - 1 if chance < shape.skew else 0
        node = open_leaves.pop(place)
        children = [len(left), len(left) + 1]
        left[node], right[node] = children
        for child in children if side < 0.5 else reversed(children):
            if depth[node] + 1 < shape.depth:
                open_leaves.append(child)
        left += [-1, -1]
        right += [-1, -1]
        parent += [node, node]
        depth += [depth[node] + 1] * 2
    return left, right, parent


def _shortest(number: np.float32) -> float:
    """The float64 whose shortest decimal is that of the float32."""
    return float(str(number))


def _model(shape: ForestShape, trees: list[dict[str, Any]]) -> dict[str, Any]:
    per_round = shape.outputs
    return {
        "learner": {
            "attributes": {},
            "feature_names": [],
            "feature_types": [],
            "gradient_booster": {
                "model": {
                    "cats": {"enc": [], "feature_segments": [], "sorted_idx": []},
                    "gbtree_model_param": {"num_parallel_tree": "1", "num_trees": str(len(trees))},
                    "iteration_indptr": list(range(0, len(trees) + 1, per_round)),
                    "tree_info": [tree % per_round for tree in range(len(trees))],
                    "trees": trees,
                },
                "name": "gbtree",
            },
            "learner_model_param": {
                "base_score": json.dumps([round(0.1 * output, 1) for output in range(shape.outputs)]),
                "boost_from_average": "1",
                "num_class": "0",
                "num_feature": str(shape.features),
                "num_target": str(shape.outputs),
            },
            "objective": {
                "name": "reg:squarederror",
                "reg_loss_param": {"scale_pos_weight": "1"},
            },
        },
        "version": _VERSION,
    }

"""Writes XGBoost models as one ONNX TreeEnsembleRegressor with one output per channel.

XGBoost goes left where x < threshold in float32, which is ONNX's BRANCH_LT, and by `default_left`
where x is missing. Sums are ONNX Runtime's own, so that predictions agree to its rounding, not to
the bit.
"""

import json
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import onnx
import xgboost
from onnx import TensorProto, helper, numpy_helper

from taxel.channels import CHANNELS
from taxel.manifest import INPUT_NAME, OUTPUT_NAME, Normalisation
from taxel.scaling import Scaler
from taxel_exporters.onnx_file import IR_VERSION, OPSET, plain
from taxel_models.families.xgb import XgbModel
from taxel_models.training.trained import TrainedModel

_ML_OPSET: Final = 3


def trees_onnx(trained: TrainedModel) -> onnx.ModelProto:
    """The ONNX model of 21 boosters: raw windows in, counts out."""
    fitted = trained.fitted
    assert isinstance(fitted, XgbModel)
    columns = len(trained.layout.features)
    taken = trained.spec.length if trained.served_extras else columns
    return forest_onnx(fitted.boosters, trained.record.normalisation, columns, taken)


def forest_onnx(
    boosters: Sequence[xgboost.Booster], normalisation: Normalisation, columns: int, taken: int
) -> onnx.ModelProto:
    """The ONNX model of one booster per channel: raw windows in, counts out.

    Args:
        normalisation: of the boosters' inputs and outputs.
        columns: of a window.
        taken: the boosters take the first `taken` columns.
    """
    inputs = Scaler.of(normalisation.input_mean, normalisation.input_std)
    outputs = Scaler.of(normalisation.output_mean, normalisation.output_std)
    constants = {
        "input_mean": inputs.mean,
        "input_std": inputs.std,
        "output_mean": outputs.mean,
        "output_std": outputs.std,
    }
    window, before = INPUT_NAME, []
    if taken < columns:
        # Extras that others in an ensemble take stand behind the window. Trees do not use them.
        constants |= {
            "first": np.array([0]),
            "length": np.array([taken]),
            "axis": np.array([1]),
        }
        window = "window_alone"
        before = [helper.make_node("Slice", [INPUT_NAME, "first", "length", "axis"], [window])]
    nodes = [
        *before,
        helper.make_node("Sub", [window, "input_mean"], ["centred"]),
        helper.make_node("Div", ["centred", "input_std"], ["columns"]),
        helper.make_node(
            "TreeEnsembleRegressor",
            ["columns"],
            ["z_scores"],
            domain="ai.onnx.ml",
            n_targets=len(boosters),
            **_attributes(boosters),
        ),
        helper.make_node("Mul", ["z_scores", "output_std"], ["scaled"]),
        helper.make_node("Add", ["scaled", "output_mean"], [OUTPUT_NAME]),
    ]
    graph = helper.make_graph(
        nodes,
        "taxel",
        [helper.make_tensor_value_info(INPUT_NAME, TensorProto.FLOAT, ["n", columns])],
        [helper.make_tensor_value_info(OUTPUT_NAME, TensorProto.FLOAT, ["n", len(CHANNELS)])],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    opsets = [helper.make_opsetid("", OPSET), helper.make_opsetid("ai.onnx.ml", _ML_OPSET)]
    return plain(helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION))


def _attributes(boosters: Sequence[xgboost.Booster]) -> dict[str, Any]:
    """The node's attributes: every tree's nodes, and the leaves' values by output."""
    columns: dict[str, list[Any]] = {
        name: []
        for name in (
            *("nodes_treeids", "nodes_nodeids", "nodes_featureids", "nodes_values", "nodes_modes"),
            *("nodes_truenodeids", "nodes_falsenodeids", "nodes_missing_value_tracks_true"),
            *("target_treeids", "target_nodeids", "target_ids", "target_weights"),
        )
    }
    base_values = []
    number = 0
    for output, booster in enumerate(boosters):
        learner = json.loads(booster.save_raw("json"))["learner"]
        base_values.append(float(learner["learner_model_param"]["base_score"].strip("[]")))
        for tree in learner["gradient_booster"]["model"]["trees"]:
            _add_tree(columns, number, output, tree)
            number += 1
    return {**columns, "base_values": base_values}


def _add_tree(columns: dict[str, list[Any]], number: int, output: int, tree: dict[str, Any]) -> None:
    left = np.array(tree["left_children"])
    leaves = left == -1
    nodes = len(left)
    values = np.where(leaves, 0.0, np.array(tree["split_conditions"], np.float32))
    columns["nodes_treeids"] += [number] * nodes
    columns["nodes_nodeids"] += range(nodes)
    columns["nodes_featureids"] += np.where(leaves, 0, tree["split_indices"]).tolist()
    columns["nodes_values"] += values.tolist()
    columns["nodes_modes"] += ["LEAF" if leaf else "BRANCH_LT" for leaf in leaves]
    columns["nodes_truenodeids"] += np.where(leaves, 0, left).tolist()
    columns["nodes_falsenodeids"] += np.where(leaves, 0, tree["right_children"]).tolist()
    columns["nodes_missing_value_tracks_true"] += np.where(leaves, 0, tree["default_left"]).tolist()
    places = np.flatnonzero(leaves)
    columns["target_treeids"] += [number] * len(places)
    columns["target_nodeids"] += places.tolist()
    columns["target_ids"] += [output] * len(places)
    columns["target_weights"] += np.array(tree["split_conditions"], np.float32)[places].tolist()

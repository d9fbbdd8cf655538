"""Writes an ensemble as one ONNX model: its members side by side, their mean and their spread."""

from dataclasses import replace
from typing import Final

import onnx
import onnx.compose
from onnx import TensorProto, helper

from taxel.channels import CHANNELS
from taxel.manifest import INPUT_NAME, OUTPUT_NAME, SPREAD_NAME
from taxel_exporters.onnx_file import IR_VERSION, plain
from taxel_exporters.onnx_network import network_onnx
from taxel_exporters.onnx_trees import trees_onnx
from taxel_models.families.ensemble import EnsembleModel
from taxel_models.families.xgb import XgbModel
from taxel_models.training.trained import TrainedModel

_BY_MEMBER: Final = "member{}_"


def ensemble_onnx(trained: TrainedModel) -> onnx.ModelProto:
    """The ONNX model of a trained ensemble.

    It has two outputs: the members' mean and their spread (standard deviation), both (n, 21) in counts.
    """
    ensemble = trained.fitted
    assert isinstance(ensemble, EnsembleModel)
    nodes, initializers, predictions = [], [], []
    opsets: dict[str, int] = {}
    for number, (_, fitted) in enumerate(ensemble.members, start=1):
        member = replace(trained, fitted=fitted)
        model = trees_onnx(member) if isinstance(fitted, XgbModel) else network_onnx(member)
        graph = _prefixed(model, _BY_MEMBER.format(number))
        nodes += graph.node
        initializers += graph.initializer
        predictions.append(graph.output[0].name)
        opsets |= {opset.domain: opset.version for opset in model.opset_import}
    squares = []
    nodes.append(helper.make_node("Mean", predictions, [OUTPUT_NAME]))
    for prediction in predictions:
        away, square = f"{prediction}_away", f"{prediction}_square"
        nodes.append(helper.make_node("Sub", [prediction, OUTPUT_NAME], [away]))
        nodes.append(helper.make_node("Mul", [away, away], [square]))
        squares.append(square)
    nodes.append(helper.make_node("Mean", squares, ["variance"]))
    nodes.append(helper.make_node("Sqrt", ["variance"], [SPREAD_NAME]))
    columns = len(trained.layout.features)
    graph = helper.make_graph(
        nodes,
        "taxel",
        [helper.make_tensor_value_info(INPUT_NAME, TensorProto.FLOAT, ["n", columns])],
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", len(CHANNELS)])
            for name in (OUTPUT_NAME, SPREAD_NAME)
        ],
        initializers,
    )
    imports = [helper.make_opsetid(domain, version) for domain, version in opsets.items()]
    return plain(helper.make_model(graph, opset_imports=imports, ir_version=IR_VERSION))


def _prefixed(model: onnx.ModelProto, prefix: str) -> onnx.GraphProto:
    """A member's graph with its own names, except for the window, which all members share."""
    graph = onnx.compose.add_prefix_graph(model.graph, prefix)
    for node in graph.node:
        for place, name in enumerate(node.input):
            if name == f"{prefix}{INPUT_NAME}":
                node.input[place] = INPUT_NAME
    return graph

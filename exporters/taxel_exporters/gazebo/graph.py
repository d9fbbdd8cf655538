"""Writes a network of the plugin as ONNX: from our windows to counts of our channels."""

from typing import Final

import numpy as np
import onnx

from taxel.manifest import INPUT_NAME
from taxel_exporters.gazebo.columns import CHANNEL_COLUMNS, FEATURES, INPUT_COLUMNS
from taxel_exporters.gazebo.network import Dense, Merge, Network
from taxel_exporters.onnx_graph import Graph

_ACTIVATIONS: Final = {"relu": "Relu", "sigmoid": "Sigmoid"}


def network_onnx(network: Network) -> onnx.ModelProto:
    """The ONNX model of a network; it orders and normalises the columns."""
    graph = Graph()
    ordered = graph.node("Gather", INPUT_NAME, graph.constant(INPUT_COLUMNS, np.int64), axis=1)
    centred = graph.node("Sub", ordered, graph.constant(network.inputs.mean))
    values = {network.input_name: graph.node("Div", centred, graph.constant(network.inputs.std))}
    for layer in network.layers:
        values[layer.name] = _add(graph, layer, values)
    served = list(CHANNEL_COLUMNS)
    chosen = graph.node("Gather", values[network.output_name], graph.constant(served, np.int64), axis=1)
    scaled = graph.node("Mul", chosen, graph.constant(np.asarray(network.outputs.std)[served]))
    graph.node("Add", scaled, graph.constant(np.asarray(network.outputs.mean)[served]))
    return graph.model(len(FEATURES))


def _add(graph: Graph, layer: Dense | Merge, values: dict[str, str]) -> str:
    """Add a layer and return its output's name."""
    if isinstance(layer, Merge):
        operation = "Mul" if layer.operation == "Multiply" else "Add"
        name, *others = (values[source] for source in layer.sources)
        for other in others:
            name = graph.node(operation, name, other)
        return name
    bias = [] if layer.bias is None else [graph.constant(layer.bias)]
    name = graph.node("Gemm", values[layer.source], graph.constant(layer.weights), *bias)
    activation = _ACTIVATIONS.get(layer.activation)
    return name if activation is None else graph.node(activation, name)

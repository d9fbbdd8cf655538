"""Writes a network of the plugin as ONNX: our windows in, counts of our channels out."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import NodeProto, TensorProto, helper, numpy_helper

from taxel.manifest import INPUT_NAME, OUTPUT_NAME
from taxel_exporters.gazebo.columns import CHANNEL_COLUMNS, FEATURES, INPUT_COLUMNS
from taxel_exporters.gazebo.network import Dense, Merge, Network
from taxel_exporters.onnx_file import IR_VERSION, OPSET

_ACTIVATIONS: Final = {"relu": "Relu", "sigmoid": "Sigmoid"}


def network_onnx(network: Network) -> onnx.ModelProto:
    """The ONNX model of a network; its columns are put in order and normalised inside."""
    graph = _Graph()
    ordered = graph.node("Gather", INPUT_NAME, graph.constant(INPUT_COLUMNS, np.int64), axis=1)
    centred = graph.node("Sub", ordered, graph.constant(network.inputs.mean))
    values = {network.input_name: graph.node("Div", centred, graph.constant(network.inputs.std))}
    for layer in network.layers:
        values[layer.name] = graph.layer(layer, values)
    served = list(CHANNEL_COLUMNS)
    chosen = graph.node("Gather", values[network.output_name], graph.constant(served, np.int64), axis=1)
    scaled = graph.node("Mul", chosen, graph.constant(np.asarray(network.outputs.std)[served]))
    mean = graph.constant(np.asarray(network.outputs.mean)[served])
    graph.nodes.append(helper.make_node("Add", [scaled, mean], [OUTPUT_NAME]))
    return graph.model()


@dataclass
class _Graph:
    """Nodes and constants so far; names are numbers, so that none comes from the file."""

    nodes: list[NodeProto] = field(default_factory=list)
    constants: list[TensorProto] = field(default_factory=list)

    def node(self, operation: str, *inputs: str, **attributes: Any) -> str:
        """Add a node; its output's name."""
        name = f"v{len(self.nodes)}"
        self.nodes.append(helper.make_node(operation, inputs, [name], **attributes))
        return name

    def constant(self, values: ArrayLike, kind: type[np.generic] = np.float32) -> str:
        """Add a constant; its name."""
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(values, kind), name))
        return name

    def layer(self, layer: Dense | Merge, values: dict[str, str]) -> str:
        """Add a layer; its output's name."""
        if isinstance(layer, Merge):
            operation = "Mul" if layer.operation == "Multiply" else "Add"
            name, *others = (values[source] for source in layer.sources)
            for other in others:
                name = self.node(operation, name, other)
            return name
        bias = [] if layer.bias is None else [self.constant(layer.bias)]
        name = self.node("Gemm", values[layer.source], self.constant(layer.weights), *bias)
        activation = _ACTIVATIONS.get(layer.activation)
        return name if activation is None else self.node(activation, name)

    def model(self) -> onnx.ModelProto:
        """The finished, checked model."""
        graph = helper.make_graph(
            self.nodes,
            "taxel",
            [helper.make_tensor_value_info(INPUT_NAME, TensorProto.FLOAT, ["n", len(FEATURES)])],
            [helper.make_tensor_value_info(OUTPUT_NAME, TensorProto.FLOAT, ["n", len(CHANNEL_COLUMNS)])],
            self.constants,
        )
        opsets = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION, producer_name="taxel")
        onnx.checker.check_model(model)
        return model

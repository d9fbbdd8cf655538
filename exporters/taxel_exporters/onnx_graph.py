"""An ONNX graph that is written node by node: window in, channels out."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import NodeProto, TensorProto, helper, numpy_helper

from taxel.channels import CHANNELS
from taxel.manifest import INPUT_NAME, OUTPUT_NAME
from taxel_exporters.onnx_file import IR_VERSION, OPSET, plain

_OPSETS: Final = [helper.make_opsetid("", OPSET)]


@dataclass
class Graph:
    """The nodes and constants so far. Names are numbers, so no name comes from the exported model."""

    nodes: list[NodeProto] = field(default_factory=list)
    constants: list[TensorProto] = field(default_factory=list)

    def node(self, operation: str, *inputs: str, **attributes: Any) -> str:
        """Add a node and return its output's name."""
        name = f"v{len(self.nodes)}"
        self.nodes.append(helper.make_node(operation, inputs, [name], **attributes))
        return name

    def split(self, value: str, parts: int, axis: int) -> tuple[str, ...]:
        """Add a node that divides a value into equal parts, and return their names."""
        names = tuple(f"v{len(self.nodes)}_{part}" for part in range(parts))
        self.nodes.append(helper.make_node("Split", [value], names, axis=axis, num_outputs=parts))
        return names

    def constant(self, values: ArrayLike, kind: type[np.generic] = np.float32) -> str:
        """Add a constant and return its name."""
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.array(values, kind, order="C"), name))
        return name

    def model(self, columns: int) -> onnx.ModelProto:
        """The finished, checked model: (n, columns) in, and what the last node gives, (n, 21), out."""
        self.nodes[-1].output[0] = OUTPUT_NAME
        graph = helper.make_graph(
            self.nodes,
            "taxel",
            [helper.make_tensor_value_info(INPUT_NAME, TensorProto.FLOAT, ["n", columns])],
            [helper.make_tensor_value_info(OUTPUT_NAME, TensorProto.FLOAT, ["n", len(CHANNELS)])],
            self.constants,
        )
        return plain(helper.make_model(graph, opset_imports=_OPSETS, ir_version=IR_VERSION))

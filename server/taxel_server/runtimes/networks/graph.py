"""Reads an ONNX file for a single window: every shape is known, and constants are computed."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import NodeProto, TensorShapeProto, helper, numpy_helper, shape_inference
from onnx.reference import ReferenceEvaluator

_OLDEST: Final = 18
"""The oldest ONNX operator set whose operations have the meaning that `lowering` expects."""

Shapes = Mapping[str, tuple[int, ...]]


class Unsupported(Exception):
    """A program cannot compute a part of the network."""


class Node(NamedTuple):
    """One operation. An optional input without a value has an empty name."""

    operation: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: Mapping[str, Any]


class Graph(NamedTuple):
    """A network for one window.

    Attributes:
        nodes: in an order of execution.
        constants: tensors that do not depend on the window.
        shapes: the shapes of all tensors that depend on the window.
        window: the input's name.
        channels: the output's name.
    """

    nodes: list[Node]
    constants: Mapping[str, NDArray[Any]]
    shapes: Shapes
    window: str
    channels: str


def read_graph(path: Path) -> Graph:
    """The graph of a file that ONNX Runtime has loaded.

    Raises:
        Unsupported: a node is not ONNX's own or of an old version, a shape depends on values, or
            there are several outputs.
    """
    model = onnx.load(path)
    (version,) = (each.version for each in model.opset_import if not each.domain)
    if version < _OLDEST:
        raise Unsupported(f"operators of version {version}: expected at least {_OLDEST}")
    if len(model.graph.input) != 1 or len(model.graph.output) != 1:
        raise Unsupported("more than one input or output")
    for tensor in (*model.graph.input, *model.graph.output):
        tensor.type.tensor_type.shape.dim[0].dim_value = 1
    graph = shape_inference.infer_shapes(model, data_prop=True).graph
    constants = {each.name: numpy_helper.to_array(each) for each in graph.initializer}
    shapes = {
        each.name: _sizes(each.type.tensor_type.shape)
        for each in (*graph.input, *graph.value_info, *graph.output)
    }
    nodes = []
    for node in graph.node:
        constant = _constant_outputs(node, constants, shapes)
        constants.update(constant)
        if not constant:
            nodes.append(_node(node, shapes))
    return Graph(nodes, constants, shapes, graph.input[0].name, graph.output[0].name)


def _sizes(shape: TensorShapeProto) -> tuple[int, ...]:
    """The sizes of a shape; -1 for an unknown size."""
    return tuple(size.dim_value if size.HasField("dim_value") else -1 for size in shape.dim)


def _known(name: str, shapes: Shapes) -> bool:
    return name in shapes and min(shapes[name], default=1) > 0


def _constant_outputs(
    node: NodeProto, constants: Mapping[str, NDArray[Any]], shapes: Shapes
) -> dict[str, NDArray[Any]]:
    """A node's outputs if they do not depend on the window's values; otherwise nothing."""
    given = {name: constants[name] for name in node.input if name in constants}
    if node.op_type == "Shape" and _known(node.input[0], shapes):
        given = {node.input[0]: np.empty(shapes[node.input[0]])}
    if node.domain or given.keys() != set(node.input) - {""}:
        return {}
    return dict(zip(node.output, ReferenceEvaluator(node).run(None, given), strict=True))


def _node(node: NodeProto, shapes: Shapes) -> Node:
    if node.domain:
        raise Unsupported(f"{node.domain}'s {node.op_type}")
    for name in node.output:
        if not _known(name, shapes):
            raise Unsupported(f"the shape of {name} is not known")
    attributes = {each.name: helper.get_attribute_value(each) for each in node.attribute}
    return Node(node.op_type, tuple(node.input), tuple(node.output), attributes)

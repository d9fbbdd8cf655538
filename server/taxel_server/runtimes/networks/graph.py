"""Reads an ONNX file as it is for a single window: every shape known, constants computed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import NodeProto, TensorShapeProto, helper, numpy_helper, shape_inference

Array = NDArray[Any]

_OLDEST: Final = 18
"""ONNX's operator set from which on the operations mean what is carried out here."""


class Unsupported(Exception):
    """A network has something that there is no step for."""


@dataclass(frozen=True)
class Node:
    """One operation; an input that is left out has no name."""

    operation: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: Mapping[str, Any]


@dataclass(frozen=True)
class Graph:
    """A network for one window.

    Attributes:
        nodes: in an order in which each finds its inputs.
        constants: tensors that do not depend on the window.
        shapes: of every tensor that does.
    """

    nodes: tuple[Node, ...]
    constants: Mapping[str, Array]
    shapes: Mapping[str, tuple[int, ...]]
    window: str
    channels: str


def read_graph(path: Path) -> Graph:
    """The graph of a file that ONNX Runtime has taken.

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
    inferred = shape_inference.infer_shapes(model, data_prop=True).graph
    constants = {each.name: numpy_helper.to_array(each) for each in inferred.initializer}
    shapes = {
        each.name: _sizes(each.type.tensor_type.shape)
        for each in (*inferred.input, *inferred.value_info, *inferred.output)
    }
    nodes = []
    for node in map(_node, inferred.node):
        fold = _FOLDED.get(node.operation)
        content = fold(node, constants, shapes) if fold else None
        if content is None:
            nodes.append(node)
        else:
            constants[node.outputs[0]] = content
    for node in nodes:
        for name in node.outputs:
            if min(shapes.get(name, (-1,)), default=1) < 1:
                raise Unsupported(f"the shape of {name} is not known")
    return Graph(tuple(nodes), constants, shapes, inferred.input[0].name, inferred.output[0].name)


def _sizes(shape: TensorShapeProto) -> tuple[int, ...]:
    """Sizes of a shape; -1 where they are not known."""
    return tuple(size.dim_value if size.HasField("dim_value") else -1 for size in shape.dim)


def _node(node: NodeProto) -> Node:
    if node.domain:
        raise Unsupported(f"{node.domain}'s {node.op_type}")
    attributes = {each.name: helper.get_attribute_value(each) for each in node.attribute}
    return Node(node.op_type, tuple(node.input), tuple(node.output), attributes)


_Fold = Callable[[Node, Mapping[str, Array], Mapping[str, tuple[int, ...]]], Array | None]


def _shape(node: Node, _: Mapping[str, Array], shapes: Mapping[str, tuple[int, ...]]) -> Array | None:
    shape = shapes.get(node.inputs[0])
    if shape is None or node.attributes.get("start", 0) or "end" in node.attributes:
        return None
    return np.array(shape, np.int64)


def _expand(node: Node, constants: Mapping[str, Array], _: Mapping[str, tuple[int, ...]]) -> Array | None:
    content, shape = (constants.get(name) for name in node.inputs)
    if content is None or shape is None:
        return None
    return np.array(content * np.ones(shape.tolist(), content.dtype))


_FOLDED: Final[dict[str, _Fold]] = {"Shape": _shape, "Expand": _expand}
"""What a network asks of its batch's size, which is one."""

"""Evaluates the ONNX graph of a dense network with NumPy alone.

A user would write it by hand like this: each layer is a product, an addition and an activation.
`onnx.reference` evaluates any graph with NumPy, but it would be a weak peer: it is made to be read.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import NodeProto, helper, numpy_helper

from taxel.errors import Unavailable

Array = NDArray[Any]
_Step = tuple[Callable[..., Array], dict[str, Any], list[str | Array], str]
"""A function, its attributes, its arguments (a constant, or the name of an earlier output), its output."""

_PLAIN_GEMM: Final = {"alpha": 1, "beta": 1, "transA": 0}
"""What `_gemm` computes, and a node of a dense network asks for."""


def _gemm(x: Array, weights: Array, bias: Array, transB: int = 0, **_plain: float) -> Array:  # noqa: N803
    return x @ (weights.T if transB else weights) + bias


def _elu(x: Array, *, alpha: float) -> Array:
    return np.where(x < 0, np.float32(alpha) * np.expm1(np.minimum(x, 0)), x)


def _leaky_relu(x: Array, *, alpha: float) -> Array:
    return np.where(x < 0, np.float32(alpha) * x, x)


def _slice(x: Array, starts: Array, ends: Array, axes: Array, steps: Array | None = None) -> Array:
    chosen = [slice(None)] * x.ndim
    strides = [1] * len(starts) if steps is None else steps
    for start, end, axis, stride in zip(starts, ends, axes, strides, strict=True):
        chosen[axis] = slice(start, end, stride)
    return x[tuple(chosen)]


_OPERATORS: Final[dict[str, Callable[..., Array]]] = {
    "Add": np.add,
    "Sub": np.subtract,
    "Mul": np.multiply,
    "Div": np.divide,
    "Tanh": np.tanh,
    "Gemm": _gemm,
    "Relu": lambda x: np.maximum(x, 0),
    "LeakyRelu": _leaky_relu,
    "Elu": _elu,
    "Clip": np.clip,
    "Sigmoid": lambda x: 1 / (1 + np.exp(-x)),
    "Slice": _slice,
    "Shape": lambda x, start=0, end=None: np.array(x.shape[start:end]),
    "Expand": lambda x, shape: np.broadcast_to(x, np.broadcast_shapes(x.shape, tuple(shape))),
    "Concat": lambda *parts, axis: np.concatenate(parts, axis),
}


class NumpyGraph:
    """The graph of a dense network.

    Args:
        model: with one input and no branches.

    Raises:
        Unavailable: the graph has another operator than those of dense networks, or other products.
    """

    def __init__(self, model: onnx.ModelProto) -> None:
        graph = model.graph
        unknown = sorted({node.op_type for node in graph.node} - set(_OPERATORS))
        if unknown:
            raise Unavailable(f"no dense network: its graph has {', '.join(unknown)}")
        constants = {constant.name: numpy_helper.to_array(constant) for constant in graph.initializer}
        self._steps = [_step(node, constants) for node in graph.node]
        self._input = graph.input[0].name
        self._output = graph.output[0].name

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The graph's first output for windows (n, f)."""
        values: dict[str, Array] = {self._input: windows}
        for function, attributes, inputs, output in self._steps:
            arguments = [values[given] if isinstance(given, str) else given for given in inputs]
            values[output] = function(*arguments, **attributes)
        counts: NDArray[np.float32] = values[self._output]
        return counts


def _step(node: NodeProto, constants: dict[str, Array]) -> _Step:
    attributes = {attribute.name: helper.get_attribute_value(attribute) for attribute in node.attribute}
    if node.op_type == "Gemm":
        for name, plain in _PLAIN_GEMM.items():
            if attributes.get(name, plain) != plain:
                raise Unavailable(f"no dense network: a Gemm has {name} {attributes[name]:g}")
    inputs = [constants.get(name, name) for name in node.input]
    return _OPERATORS[node.op_type], attributes, inputs, node.output[0]

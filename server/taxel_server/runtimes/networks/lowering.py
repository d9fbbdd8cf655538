"""Writes a graph's operations as a program's steps."""

from collections.abc import Callable
from math import prod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.networks.graph import Graph, Node, Unsupported
from taxel_server.runtimes.networks.operations import (
    Arithmetic,
    Copy,
    Elementwise,
    Function,
    Normalise,
    Pairwise,
    Place,
    Softmax,
    Sum,
)
from taxel_server.runtimes.networks.panels import LANES, MOST_ROWS, arrange
from taxel_server.runtimes.networks.program import Draft, Program, Value, dense_strides

_CACHED: Final = 2**20
"""Bytes of weights that a core keeps in its own cache: to round them would gain nothing."""

_COPIED_AXES: Final = 4


def lower(graph: Graph) -> Program:
    """The program of a graph.

    Raises:
        Unsupported: there is no step for one of its operations.
    """
    return _Lowering(graph).program()


class _Lowering:
    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._draft = Draft()
        self._values: dict[str, Value] = {}
        self._rounded = sum(each.nbytes for each in graph.constants.values() if each.ndim > 1) > _CACHED

    def program(self) -> Program:
        window = self._draft.room(*self._graph.shapes[self._graph.window])
        self._values[self._graph.window] = window
        for node in self._graph.nodes:
            rule = _RULES.get(node.operation)
            if rule is None:
                raise Unsupported(node.operation)
            rule(self, node)
        channels = self._contiguous(self._operand(self._graph.channels))
        return self._draft.finish(window, channels)

    def pairwise(self, node: Node) -> None:
        which, swaps = _ARITHMETIC[node.operation]
        left, right = (self._contiguous(self._operand(name)) for name in node.inputs)
        if left.size < right.size and swaps:
            left, right = right, left
        period = tuple(right.shape)
        while period and period[0] == 1:
            period = period[1:]
        if left.shape[len(left.shape) - len(period) :] != period or len(period) > len(left.shape):
            raise Unsupported(f"{node.operation} of {left.shape} and {right.shape}")
        result = self._result(node)
        if result.size != left.size:
            raise Unsupported(f"{node.operation} of {left.shape} and {right.shape}")
        width = max(right.size, 1)
        places = (result.place, left.place, right.place)
        self._draft.step(Pairwise(*places, rows=left.size // width, width=width, which=which))

    def function(self, node: Node) -> None:
        which = _FUNCTIONS[node.operation]
        parameters = np.zeros(2, np.float32)
        if which in (Function.LEAKY_RELU, Function.ELU):
            parameters[0] = node.attributes.get("alpha", 0.01 if which is Function.LEAKY_RELU else 1.0)
        elif which is Function.CLIP:
            bounds = [*node.inputs[1:], "", ""][:2]
            for bound, (name, unbounded) in enumerate(zip(bounds, (-np.inf, np.inf), strict=True)):
                parameters[bound] = self._constant(name).item() if name else unbounded
        elif node.attributes.get("approximate", b"none") != b"none":
            raise Unsupported("an approximate GELU")
        value = self._contiguous(self._operand(node.inputs[0]))
        result = self._result(node)
        places = (result.place, value.place, self._draft.constant(parameters).place)
        self._draft.step(Elementwise(*places, size=value.size, which=which))

    def gemm(self, node: Node) -> None:
        chosen = {"alpha": 1.0, "beta": 1.0, "transA": 0, "transB": 0, **node.attributes}
        if (chosen["alpha"], chosen["beta"], chosen["transA"]) != (1.0, 1.0, 0):
            raise Unsupported("a scaled or transposed Gemm")
        weights = self._constant(node.inputs[1])
        bias = self._constant(node.inputs[2]).reshape(-1) if len(node.inputs) > 2 else None
        self._dense(node, weights.T if chosen["transB"] else weights, bias)

    def matmul(self, node: Node) -> None:
        weights = self._graph.constants.get(node.inputs[1])
        if weights is not None and weights.ndim == 2:
            self._dense(node, weights, None)
            return
        left, right = (self._operand(name) for name in node.inputs)
        if left.strides[-1] != 1 and left.shape[-1] != 1:
            left = self._contiguous(left)
        (groups, left_apart), (others, right_apart) = _groups(left), _groups(right)
        if groups != others:
            raise Unsupported(f"MatMul of {left.shape} and {right.shape}")
        self._draft.product(self._result(node), left, right, (groups, left_apart, right_apart))

    def layer_normalisation(self, node: Node) -> None:
        value = self._contiguous(self._operand(node.inputs[0]))
        if not _is_last(node.attributes.get("axis", -1), value) or len(node.outputs) > 1:
            raise Unsupported("LayerNormalization over several axes")
        width = value.shape[-1]
        weight = self._operand(node.inputs[1])
        bias = self._operand(node.inputs[2]) if len(node.inputs) > 2 else self._kept(np.zeros(width))
        if (weight.size, bias.size) != (width, width):
            raise Unsupported("LayerNormalization with broadcast weights")
        epsilon = self._kept(np.array([node.attributes.get("epsilon", 1e-5)]))
        places = (weight.place, bias.place, epsilon.place)
        rows = value.size // width
        self._draft.step(Normalise(self._result(node).place, value.place, *places, rows=rows, width=width))

    def softmax(self, node: Node) -> None:
        value = self._contiguous(self._operand(node.inputs[0]))
        if not _is_last(node.attributes.get("axis", -1), value):
            raise Unsupported("Softmax over another axis than the last")
        width = value.shape[-1]
        rows = value.size // width
        self._draft.step(Softmax(self._result(node).place, value.place, rows=rows, width=width))

    def reduce_sum(self, node: Node) -> None:
        value = self._contiguous(self._operand(node.inputs[0]))
        axes = self._constant(node.inputs[1]).tolist() if len(node.inputs) > 1 else []
        if len(axes) != 1:
            raise Unsupported("ReduceSum over several axes")
        axis = axes[0] % len(value.shape)
        sizes = (prod(value.shape[:axis]), value.shape[axis], prod(value.shape[axis + 1 :]))
        self._draft.step(Sum(self._result(node).place, value.place, *sizes))

    def reshape(self, node: Node) -> None:
        value = self._contiguous(self._operand(node.inputs[0]))
        shape = self._graph.shapes[node.outputs[0]]
        self._values[node.outputs[0]] = Value(value.place, shape, dense_strides(shape))

    def transpose(self, node: Node) -> None:
        value = self._operand(node.inputs[0])
        order = node.attributes.get("perm", range(len(value.shape))[::-1])
        self._values[node.outputs[0]] = Value(
            value.place,
            tuple(value.shape[axis] for axis in order),
            tuple(value.strides[axis] for axis in order),
        )

    def split(self, node: Node) -> None:
        value = self._operand(node.inputs[0])
        axis, first = node.attributes.get("axis", 0), 0
        for name in node.outputs:
            count = self._graph.shapes[name][axis]
            self._values[name] = _part(value, axis, first, count)
            first += count

    def slice(self, node: Node) -> None:
        value = self._operand(node.inputs[0])
        starts, ends, *others = (self._constant(name).tolist() for name in node.inputs[1:])
        axes = others[0] if others else range(len(starts))
        if len(others) > 1 and set(others[1]) != {1}:
            raise Unsupported("Slice with steps")
        for axis, start, end in zip(axes, starts, ends, strict=True):
            first, after, _ = slice(start, end).indices(value.shape[axis])
            value = _part(value, axis, first, after - first)
        self._values[node.outputs[0]] = value

    def gather(self, node: Node) -> None:
        value, axis = self._operand(node.inputs[0]), node.attributes.get("axis", 0)
        index = self._constant(node.inputs[1])
        places = (index.reshape(-1) % value.shape[axis]).tolist()
        first = places[0]
        if places != list(range(first, first + index.size)):
            raise Unsupported("Gather of places that are not side by side")
        part = _part(value, axis, first, index.size)
        if index.ndim == 0:
            axis %= len(part.shape)
            shape, strides = list(part.shape), list(part.strides)
            del shape[axis], strides[axis]
            part = Value(part.place, tuple(shape), tuple(strides))
        self._values[node.outputs[0]] = part

    def concat(self, node: Node) -> None:
        parts = [self._operand(name) for name in node.inputs]
        self._side_by_side(self._result(node), node.attributes["axis"], 0, parts)

    def pad(self, node: Node) -> None:
        value = self._operand(node.inputs[0])
        pads = self._constant(node.inputs[1]).tolist()
        before = pads[: len(value.shape)]
        padded = [axis for axis in range(len(value.shape)) if pads[axis] or pads[axis + len(value.shape)]]
        others = [name for name in node.inputs[2:] if name]
        if node.attributes.get("mode", b"constant") != b"constant" or len(padded) != 1 or others:
            raise Unsupported("Pad but with zeros along one axis")
        # Kept like a constant: nothing else is ever written to it, so that its zeros stay.
        result = self._draft.constant(np.zeros(self._graph.shapes[node.outputs[0]], np.float32))
        self._values[node.outputs[0]] = result
        self._side_by_side(result, padded[0], before[padded[0]], [value])

    def _side_by_side(self, result: Value, axis: int, first: int, parts: list[Value]) -> None:
        """Copies tensors to places next to each other along an axis."""
        axis %= len(result.shape)
        if prod(result.shape[:axis]) != 1:
            raise Unsupported("tensors to put together row by row")
        place = result.place.offset + first * result.strides[axis]
        for part in parts:
            self._copy(Place(result.place.buffer, place), part)
            place += part.size

    def _dense(self, node: Node, weights: NDArray[Any], bias: NDArray[Any] | None) -> None:
        value = self._contiguous(self._operand(node.inputs[0]))
        terms, columns = weights.shape
        rows = value.size // terms
        padded = np.zeros(-(-columns // LANES) * LANES)
        if bias is not None:
            padded[:columns] = bias
        panels = arrange(weights.astype(np.float32), self._rounded and rows <= MOST_ROWS)
        result = self._draft.dense(value, rows, columns, panels, self._kept(padded))
        shape = self._graph.shapes[node.outputs[0]]
        self._values[node.outputs[0]] = Value(result.place, shape, dense_strides(shape))

    def _operand(self, name: str) -> Value:
        if name not in self._values:
            self._values[name] = self._kept(self._constant(name))
        return self._values[name]

    def _constant(self, name: str) -> NDArray[Any]:
        if name not in self._graph.constants:
            raise Unsupported(f"{name}, which would have to be a constant")
        return self._graph.constants[name]

    def _kept(self, content: NDArray[Any]) -> Value:
        return self._draft.constant(content.astype(np.float32))

    def _result(self, node: Node) -> Value:
        result = self._draft.room(*self._graph.shapes[node.outputs[0]])
        self._values[node.outputs[0]] = result
        return result

    def _contiguous(self, value: Value) -> Value:
        if value.contiguous:
            return value
        result = self._draft.room(*value.shape)
        self._copy(result.place, value)
        return result

    def _copy(self, place: Place, value: Value) -> None:
        axes = [(size, apart) for size, apart in zip(value.shape, value.strides, strict=True) if size != 1]
        if len(axes) > _COPIED_AXES:
            raise Unsupported(f"a tensor of shape {value.shape} in another order")
        axes = [(1, 0)] * (_COPIED_AXES - len(axes)) + axes
        sizes, strides = zip(*axes, strict=True)
        self._draft.step(Copy(place, value.place, *sizes, *strides))


def _groups(value: Value) -> tuple[int, int]:
    """How many matrices a tensor holds, and floats from one to the next."""
    axes = [(s, apart) for s, apart in zip(value.shape[:-2], value.strides[:-2], strict=True) if s != 1]
    if len(axes) > 1:
        raise Unsupported(f"matrices along several axes of {value.shape}")
    return axes[0] if axes else (1, 0)


def _part(value: Value, axis: int, first: int, count: int) -> Value:
    """Some entries of an axis."""
    axis %= len(value.shape)
    place = Place(value.place.buffer, value.place.offset + first * value.strides[axis])
    return Value(place, (*value.shape[:axis], count, *value.shape[axis + 1 :]), value.strides)


def _is_last(axis: int, value: Value) -> bool:
    return axis % len(value.shape) == len(value.shape) - 1


_ARITHMETIC: Final = {
    "Add": (Arithmetic.ADD, True),
    "Sub": (Arithmetic.SUBTRACT, False),
    "Mul": (Arithmetic.MULTIPLY, True),
    "Div": (Arithmetic.DIVIDE, False),
}
"""And whether the two values may change places."""

_FUNCTIONS: Final = {
    "Relu": Function.RELU,
    "LeakyRelu": Function.LEAKY_RELU,
    "Clip": Function.CLIP,
    "Tanh": Function.TANH,
    "Sigmoid": Function.SIGMOID,
    "Elu": Function.ELU,
    "Gelu": Function.GELU,
}

_RULES: Final[dict[str, Callable[[_Lowering, Node], None]]] = {
    **dict.fromkeys(_ARITHMETIC, _Lowering.pairwise),
    **dict.fromkeys(_FUNCTIONS, _Lowering.function),
    **dict.fromkeys(("Reshape", "Flatten", "Squeeze", "Unsqueeze", "Identity"), _Lowering.reshape),
    "Gemm": _Lowering.gemm,
    "MatMul": _Lowering.matmul,
    "LayerNormalization": _Lowering.layer_normalisation,
    "Softmax": _Lowering.softmax,
    "ReduceSum": _Lowering.reduce_sum,
    "Transpose": _Lowering.transpose,
    "Split": _Lowering.split,
    "Slice": _Lowering.slice,
    "Gather": _Lowering.gather,
    "Concat": _Lowering.concat,
    "Pad": _Lowering.pad,
}

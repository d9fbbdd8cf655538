"""Lowering: turns a graph's nodes into a program's steps."""

from collections.abc import Callable
from math import prod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel_server.runtimes.networks.graph import Graph, Node, Unsupported
from taxel_server.runtimes.networks.panels import LANES, panels_of
from taxel_server.runtimes.networks.program import Operation, Program, ProgramBuilder, Tensor, dense


def lower(graph: Graph) -> Program:
    """The program of a graph.

    Raises:
        Unsupported: a program cannot compute one of its operations.
    """
    lowering = _Lowering(graph)
    for node in graph.nodes:
        if node.operation not in _RULES:
            raise Unsupported(node.operation)
        _RULES[node.operation](lowering, node)
    return lowering.program()


class _Lowering:
    """A program that is being written, and the places of the graph's tensors in it."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._builder = ProgramBuilder()
        self._tensors = {graph.window: self._builder.allocate(*graph.shapes[graph.window])}
        self._panels: dict[int, Tensor] = {}

    def program(self) -> Program:
        return self._builder.finish(self._tensors[self._graph.window], self._operand(self._graph.channels))

    def arithmetic(self, node: Node) -> None:
        left, right = (self._operand(name) for name in node.inputs)
        if left.size < right.size and node.operation in ("Add", "Mul"):
            left, right = right, left
        row = tuple(right.shape)
        while row and row[0] == 1:
            row = row[1:]
        result = self._result(node)
        if left.shape[len(left.shape) - len(row) :] != row or result.size != left.size:
            raise Unsupported(f"{node.operation} of {left.shape} and {right.shape}")
        sizes = {"rows": left.size // right.size, "columns": right.size}
        self._builder.add(Operation[node.operation.upper()], result, left, right=right.place, **sizes)

    def activation(self, node: Node) -> None:
        if node.attributes.get("approximate", b"none") != b"none":
            raise Unsupported("an approximate GELU")
        parameters = [node.attributes.get("alpha", 0.01 if node.operation == "LeakyRelu" else 1.0), 0.0]
        if node.operation == "Clip":
            bounds = zip([*node.inputs[1:], "", ""], (-np.inf, np.inf), strict=False)
            parameters = [self._constant(name).item() if name else unbounded for name, unbounded in bounds]
        values, right = self._operand(node.inputs[0]), self._builder.constant(np.array(parameters)).place
        result = self._result(node)
        self._builder.add(
            Operation[node.operation.upper()], result, values, right=right, columns=values.size
        )

    def gemm(self, node: Node) -> None:
        chosen = {"alpha": 1.0, "beta": 1.0, "transA": 0, "transB": 0, **node.attributes}
        if (chosen["alpha"], chosen["beta"], chosen["transA"]) != (1.0, 1.0, 0):
            raise Unsupported("a scaled or transposed Gemm")
        weights = self._constant(node.inputs[1])
        bias = self._constant(node.inputs[2]).reshape(-1) if len(node.inputs) > 2 else np.zeros(1)
        self._dense(node, weights.T if chosen["transB"] else weights, bias)

    def matmul(self, node: Node) -> None:
        weights = self._graph.constants.get(node.inputs[1])
        if weights is not None and weights.ndim == 2:
            self._dense(node, weights, np.zeros(1))
            return
        left, right = (self._tensor(name) for name in node.inputs)
        if left.strides[-1] != 1 and left.shape[-1] != 1:
            left = self._builder.contiguous(left)
        (groups, left_group), (others, right_group) = _groups(left), _groups(right)
        if groups != others:
            raise Unsupported(f"MatMul of {left.shape} and {right.shape}")
        sizes = {"groups": groups, "rows": left.shape[-2], "terms": right.shape[-2]}
        steps = {"left_group": left_group, "left_row": left.strides[-2], "right_group": right_group}
        self._product(node, left, right, **sizes, **steps)

    def reduce_sum(self, node: Node) -> None:
        """Sums over one axis, as a product of a row of ones with matrices."""
        values = self._operand(node.inputs[0])
        axes = self._constant(node.inputs[1]).tolist() if len(node.inputs) > 1 else []
        if len(axes) != 1:
            raise Unsupported("ReduceSum over several axes")
        axis = axes[0] % len(values.shape)
        groups, terms = prod(values.shape[:axis]), values.shape[axis]
        matrices = dense(values.place, (groups, terms, values.size // groups // terms))
        sizes = {"groups": groups, "terms": terms, "right_group": matrices.strides[0]}
        self._product(node, self._builder.constant(np.ones(terms)), matrices, **sizes)

    def layer_normalisation(self, node: Node) -> None:
        values = self._operand(node.inputs[0])
        columns = values.shape[-1]
        weight = self._constant(node.inputs[1])
        bias = self._constant(node.inputs[2]) if len(node.inputs) > 2 else np.zeros(columns)
        if not _is_last(node, values) or len(node.outputs) > 1 or not weight.size == bias.size == columns:
            raise Unsupported("LayerNormalization over several axes, or with broadcast weights")
        epsilon = node.attributes.get("epsilon", 1e-5)
        right = self._builder.constant(np.concatenate([weight, bias, [epsilon]])).place
        sizes = {"rows": values.size // columns, "columns": columns}
        self._builder.add(Operation.NORMALISE, self._result(node), values, right=right, **sizes)

    def softmax(self, node: Node) -> None:
        values = self._operand(node.inputs[0])
        if not _is_last(node, values):
            raise Unsupported("Softmax over another axis than the last")
        sizes = {"rows": values.size // values.shape[-1], "columns": values.shape[-1]}
        self._builder.add(Operation.SOFTMAX, self._result(node), values, **sizes)

    def reshape(self, node: Node) -> None:
        place = self._operand(node.inputs[0]).place
        self._tensors[node.outputs[0]] = dense(place, self._graph.shapes[node.outputs[0]])

    def transpose(self, node: Node) -> None:
        values = self._tensor(node.inputs[0])
        order = node.attributes.get("perm", range(len(values.shape))[::-1])
        shape, strides = (tuple(sizes[axis] for axis in order) for sizes in (values.shape, values.strides))
        self._tensors[node.outputs[0]] = Tensor(values.place, shape, strides)

    def split(self, node: Node) -> None:
        values, axis, first = self._tensor(node.inputs[0]), node.attributes.get("axis", 0), 0
        for name in node.outputs:
            count = self._graph.shapes[name][axis]
            self._tensors[name] = values.part(axis, first, count)
            first += count

    def slice(self, node: Node) -> None:
        values = self._tensor(node.inputs[0])
        starts, ends, *others = (self._constant(name).tolist() for name in node.inputs[1:])
        axes = others[0] if others else range(len(starts))
        if len(others) > 1 and set(others[1]) != {1}:
            raise Unsupported("Slice with steps")
        for axis, start, end in zip(axes, starts, ends, strict=True):
            first, after, _ = slice(start, end).indices(values.shape[axis])
            values = values.part(axis, first, after - first)
        self._tensors[node.outputs[0]] = values

    def gather(self, node: Node) -> None:
        values, index = self._tensor(node.inputs[0]), self._constant(node.inputs[1])
        axis = node.attributes.get("axis", 0) % len(values.shape)
        if index.ndim:
            raise Unsupported("Gather of several places")
        place = values.part(axis, index.item() % values.shape[axis], 1).place
        shape, strides = ((*sizes[:axis], *sizes[axis + 1 :]) for sizes in (values.shape, values.strides))
        self._tensors[node.outputs[0]] = Tensor(place, shape, strides)

    def concat(self, node: Node) -> None:
        parts = [self._tensor(name) for name in node.inputs]
        self._side_by_side(node, node.attributes["axis"], 0, parts)

    def pad(self, node: Node) -> None:
        values = self._tensor(node.inputs[0])
        before, after = np.split(self._constant(node.inputs[1]), 2)
        axes = np.flatnonzero(before + after).tolist()
        others = [name for name in node.inputs[2:] if name]
        if node.attributes.get("mode", b"constant") != b"constant" or len(axes) != 1 or others:
            raise Unsupported("Pad but with zeros along one axis")
        self._side_by_side(node, axes[0], before[axes[0]].item(), [values])

    def _side_by_side(self, node: Node, axis: int, first: int, parts: list[Tensor]) -> None:
        """Copies tensors side by side along an axis. Other places stay zero."""
        result = self._result(node)
        if prod(result.shape[:axis]) != 1:
            raise Unsupported("tensors to put together row by row")
        for part in parts:
            self._builder.copy(result.part(axis, first, part.shape[axis]), part)
            first += part.shape[axis]

    def _dense(self, node: Node, weights: NDArray[Any], bias: NDArray[Any]) -> None:
        values = self._operand(node.inputs[0])
        terms, columns = weights.shape
        sizes = {"rows": values.size // terms, "terms": terms, "columns": columns}
        start = self._builder.weights(panels_of(weights, bias, exact=sizes["rows"] > 1))
        self._builder.add(Operation.DENSE, self._result(node), values, weights=start, **sizes)

    def _product(self, node: Node, left: Tensor, right: Tensor, **fields: int) -> None:
        """Adds a product whose right operands are the last two axes of a tensor."""
        terms, columns = right.shape[-2:]
        if terms not in self._panels:
            scale_and_bias = np.repeat([[1.0], [0.0]], LANES, axis=1)
            panel = np.concatenate([np.zeros((terms, LANES)), scale_and_bias])
            self._panels[terms] = self._builder.constant(panel)
        fields |= {"right": right.place, "panel": self._panels[terms].place, "columns": columns}
        fields |= {"right_term": right.strides[-2], "right_column": right.strides[-1]}
        self._builder.add(Operation.PRODUCT, self._result(node), left, **fields)

    def _tensor(self, name: str) -> Tensor:
        if name not in self._tensors:
            self._tensors[name] = self._builder.constant(self._constant(name))
        return self._tensors[name]

    def _operand(self, name: str) -> Tensor:
        """A contiguous tensor."""
        return self._builder.contiguous(self._tensor(name))

    def _constant(self, name: str) -> NDArray[Any]:
        if name not in self._graph.constants:
            raise Unsupported(f"{name}, which would have to be a constant")
        return self._graph.constants[name]

    def _result(self, node: Node) -> Tensor:
        name = node.outputs[0]
        self._tensors[name] = self._builder.allocate(*self._graph.shapes[name])
        return self._tensors[name]


def _groups(values: Tensor) -> tuple[int, int]:
    """The number of matrices in a tensor, and the stride from one to the next."""
    axes = Tensor(values.place, values.shape[:-2], values.strides[:-2]).axes
    if len(axes) > 1:
        raise Unsupported(f"matrices along several axes of {values.shape}")
    return axes[0] if axes else (1, 0)


def _is_last(node: Node, values: Tensor) -> bool:
    return node.attributes.get("axis", -1) in (-1, len(values.shape) - 1)


_RULES: Final[dict[str, Callable[[_Lowering, Node], None]]] = {
    **dict.fromkeys(("Add", "Sub", "Mul", "Div"), _Lowering.arithmetic),
    **dict.fromkeys(("Relu", "LeakyRelu", "Clip", "Tanh", "Sigmoid", "Elu", "Gelu"), _Lowering.activation),
    **dict.fromkeys(("Reshape", "Flatten", "Squeeze", "Unsqueeze"), _Lowering.reshape),
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

"""Counts the floating-point operations that an ONNX graph asks for, one window."""

from collections.abc import Callable, Mapping
from math import prod
from typing import Final

import onnx
from onnx import NodeProto, TensorShapeProto, shape_inference

from taxel.errors import ArtifactError
from taxel_bench.operations.rule import ELEMENTWISE, LAYER_NORMALISATION, REDUCTION, SOFTMAX, product

Shapes = Mapping[str, tuple[int, ...]]

_MOVES: Final = frozenset(
    {
        *("Cast", "Concat", "Constant", "Expand", "Flatten", "Gather", "Identity", "Pad", "Reshape"),
        *("Shape", "Slice", "Split", "Squeeze", "Transpose", "Unsqueeze"),
    }
)

_PER_VALUE: Final = {
    **dict.fromkeys(("Add", "Sub", "Mul", "Div", "Neg", "Abs", "Sqrt", "Exp", "Erf", "Pow"), ELEMENTWISE),
    **dict.fromkeys(("Relu", "LeakyRelu", "Elu", "Sigmoid", "Tanh", "Clip", "Gelu"), ELEMENTWISE),
    "Softmax": SOFTMAX,
    "LayerNormalization": LAYER_NORMALISATION,
}


def count_graph_operations(model: onnx.ModelProto) -> int:
    """Floating-point operations of a graph, one window, by `taxel_bench.operations.rule`.

    Raises:
        ArtifactError: the rule does not cover one of its operators, or a shape depends on values.
    """
    single = onnx.ModelProto()
    single.CopyFrom(model)
    for tensor in (*single.graph.input, *single.graph.output):
        tensor.type.tensor_type.shape.dim[0].dim_value = 1
    inferred = shape_inference.infer_shapes(single, data_prop=True).graph
    shapes = {constant.name: tuple(constant.dims) for constant in inferred.initializer}
    for value in (*inferred.input, *inferred.value_info, *inferred.output):
        shapes[value.name] = _sizes(value.type.tensor_type.shape)
    return sum(_count(node, shapes) for node in inferred.node)


def _sizes(shape: TensorShapeProto) -> tuple[int, ...]:
    """Sizes of a shape; -1 where they are not known."""
    return tuple(size.dim_value if size.HasField("dim_value") else -1 for size in shape.dim)


def _count(node: NodeProto, shapes: Shapes) -> int:
    if node.op_type in _MOVES:
        return 0
    if node.op_type in _PER_VALUE:
        return _PER_VALUE[node.op_type] * _values(node.output[0], shapes)
    rule = _RULES.get(node.op_type)
    if rule is None or node.domain:
        raise ArtifactError(f"no rule counts the operations of {node.domain or 'ONNX'}'s {node.op_type}")
    return rule(node, shapes)


def _values(name: str, shapes: Shapes) -> int:
    sizes = shapes.get(name, (-1,))
    if min(sizes, default=1) < 0:
        raise ArtifactError(f"the shape of {name} is not known before it is computed: expected a fixed one")
    return prod(sizes)


def _of_matmul(node: NodeProto, shapes: Shapes) -> int:
    return _values(node.output[0], shapes) * product(shapes[node.input[0]][-1])


def _of_gemm(node: NodeProto, shapes: Shapes) -> int:
    transposed = any(attribute.name == "transA" and attribute.i for attribute in node.attribute)
    terms = shapes[node.input[0]][0 if transposed else 1]
    return _values(node.output[0], shapes) * product(terms, bias=len(node.input) > 2)


def _of_reduction(node: NodeProto, shapes: Shapes) -> int:
    return REDUCTION * _values(node.input[0], shapes)


def _of_several(node: NodeProto, shapes: Shapes) -> int:
    return REDUCTION * len(node.input) * _values(node.output[0], shapes)


_RULES: Final[dict[str, Callable[[NodeProto, Shapes], int]]] = {
    "MatMul": _of_matmul,
    "Gemm": _of_gemm,
    "ReduceSum": _of_reduction,
    "ReduceMean": _of_reduction,
    "Mean": _of_several,
    "Sum": _of_several,
}

"""Rounds the weights of an ONNX network to 8 bits, so a prediction reads a quarter of the bytes.

Each block of 32 weights in one sum shares a scale. ONNX Runtime rounds their inputs in the same way, row
by row. So a window's prediction does not depend on the other windows in its batch. With one scale for
the whole batch (ONNX's DynamicQuantizeLinear) it would.
"""

from typing import Final

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import NodeProto, TensorProto, helper, numpy_helper

from taxel.errors import SettingsError
from taxel_exporters.onnx_file import plain

_BLOCK: Final = 32
"""Weights that share a scale."""

_SMALLEST: Final = 64
"""Layers with fewer inputs or outputs keep their weights: these are few, and carry most of the error."""

_STEPS: Final = 127
_ZERO: Final = 128
"""Bytes are stored without a sign; this value means 0."""

_IN_8_BITS: Final = 4
"""ONNX Runtime's accuracy level that multiplies in 8 bits; any other is slower than float32."""

_DOMAIN: Final = "com.microsoft"


def with_int8_weights(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy of a model whose large dense layers have weights of 8 bits.

    Raises:
        SettingsError: it has no large dense layer.
    """
    rounded = onnx.ModelProto()
    rounded.CopyFrom(model)
    graph = rounded.graph
    constants = {constant.name: constant for constant in graph.initializer}
    large = [
        node
        for node in graph.node
        if node.op_type == "Gemm" and min(constants[node.input[1]].dims) >= _SMALLEST
    ]
    if not large:
        raise SettingsError(
            f"--weights int8: no layer takes and gives at least {_SMALLEST} values: nothing to round"
        )
    for node in large:
        _round(node, constants)
    del graph.initializer[:]
    graph.initializer.extend(constants.values())
    rounded.opset_import.append(helper.make_opsetid(_DOMAIN, 1))
    return plain(rounded)


def _round(node: NodeProto, constants: dict[str, TensorProto]) -> None:
    """Turn a Gemm into ONNX Runtime's MatMulNBits."""
    value, name, bias = node.input
    weights = numpy_helper.to_array(constants.pop(name))
    transposed = any(attribute.name == "transB" and attribute.i for attribute in node.attribute)
    outputs_first = weights if transposed else weights.T
    stored, scales = _blocks(outputs_first)
    constants[f"{name}.int8"] = numpy_helper.from_array(stored, f"{name}.int8")
    constants[f"{name}.scale"] = numpy_helper.from_array(scales, f"{name}.scale")
    outputs, inputs = outputs_first.shape
    node.CopyFrom(
        helper.make_node(
            "MatMulNBits",
            [value, f"{name}.int8", f"{name}.scale", "", "", bias],
            list(node.output),
            domain=_DOMAIN,
            K=inputs,
            N=outputs,
            bits=8,
            block_size=_BLOCK,
            accuracy_level=_IN_8_BITS,
        )
    )


def _blocks(weights: NDArray[np.float32]) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Bytes (out, blocks, 32) and scales (out, blocks) of weights (out, in); the last block is padded."""
    outputs, inputs = weights.shape
    blocks = -(-inputs // _BLOCK)
    padded = np.zeros((outputs, blocks * _BLOCK), np.float32)
    padded[:, :inputs] = weights
    padded = padded.reshape(outputs, blocks, _BLOCK)
    scales = np.abs(padded).max(axis=2) / np.float32(_STEPS)
    scales[scales == 0] = 1
    stored = np.rint(padded / scales[:, :, None]) + _ZERO
    return stored.astype(np.uint8), scales

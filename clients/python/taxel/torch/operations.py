"""ONNX's operations in torch, as far as our exporters write them.

Tensors of whole numbers (shapes, axes, places) stay on the CPU, whatever device the window is on.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import torch
from torch import Tensor
from torch.nn import functional

from taxel.errors import ArtifactError

Inputs = Sequence[Tensor | None]
"""A node's inputs; None where an optional one is left out."""

Attributes = Mapping[str, Any]
Rule = Callable[[Inputs, Attributes], Tensor | Sequence[Tensor]]


def _given(inputs: Inputs, place: int) -> Tensor | None:
    return inputs[place] if place < len(inputs) else None


def _tensor(inputs: Inputs, place: int = 0) -> Tensor:
    value = inputs[place]
    assert value is not None
    return value


def _whole(inputs: Inputs, place: int) -> list[int]:
    numbers: list[int] = _tensor(inputs, place).reshape(-1).tolist()
    return numbers


def _elementwise(function: Callable[..., Tensor]) -> Rule:
    return lambda inputs, _: function(*inputs)


def _gemm(inputs: Inputs, attributes: Attributes) -> Tensor:
    left, right = _tensor(inputs), _tensor(inputs, 1)
    left = left.T if attributes.get("transA") else left
    right = right.T if attributes.get("transB") else right
    product: Tensor = attributes.get("alpha", 1.0) * (left @ right)
    bias = _given(inputs, 2)
    return product if bias is None else product + attributes.get("beta", 1.0) * bias


def _clip(inputs: Inputs, _: Attributes) -> Tensor:
    return torch.clamp(_tensor(inputs), _given(inputs, 1), _given(inputs, 2))


def _gelu(inputs: Inputs, attributes: Attributes) -> Tensor:
    return functional.gelu(_tensor(inputs), approximate=attributes.get("approximate", b"none").decode())


def _layer_normalisation(inputs: Inputs, attributes: Attributes) -> Tensor:
    values, axis = _tensor(inputs), attributes.get("axis", -1)
    epsilon = attributes.get("epsilon", 1e-5)
    return functional.layer_norm(
        values, values.shape[axis:], _tensor(inputs, 1), _given(inputs, 2), epsilon
    )


def _reduce_sum(inputs: Inputs, attributes: Attributes) -> Tensor:
    return _tensor(inputs).sum(_whole(inputs, 1), keepdim=bool(attributes.get("keepdims", 1)))


def _mean(inputs: Inputs, _: Attributes) -> Tensor:
    return torch.stack([_tensor(inputs, place) for place in range(len(inputs))]).mean(dim=0)


def _concat(inputs: Inputs, attributes: Attributes) -> Tensor:
    return torch.cat([_tensor(inputs, place) for place in range(len(inputs))], dim=attributes["axis"])


def _shape(inputs: Inputs, attributes: Attributes) -> Tensor:
    sizes = list(_tensor(inputs).shape)
    return torch.tensor(sizes[attributes.get("start", 0) : attributes.get("end")], dtype=torch.int64)


def _reshape(inputs: Inputs, attributes: Attributes) -> Tensor:
    values, sizes = _tensor(inputs), _whole(inputs, 1)
    if not attributes.get("allowzero"):
        sizes = [size or values.shape[axis] for axis, size in enumerate(sizes)]
    return values.reshape(sizes)


def _flatten(inputs: Inputs, attributes: Attributes) -> Tensor:
    values, axis = _tensor(inputs), attributes.get("axis", 1)
    return values.reshape(values.shape[:axis].numel(), -1)


def _squeeze(inputs: Inputs, _: Attributes) -> Tensor:
    return torch.squeeze(_tensor(inputs), tuple(_whole(inputs, 1)))


def _unsqueeze(inputs: Inputs, _: Attributes) -> Tensor:
    values, axes = _tensor(inputs), _whole(inputs, 1)
    for axis in sorted(axis % (values.ndim + len(axes)) for axis in axes):
        values = values.unsqueeze(axis)
    return values


def _transpose(inputs: Inputs, attributes: Attributes) -> Tensor:
    values = _tensor(inputs)
    return values.permute(attributes.get("perm", range(values.ndim)[::-1]))


def _expand(inputs: Inputs, _: Attributes) -> Tensor:
    # Both may be broadcast: where the given size is 1, the values' own is kept.
    values, sizes = _tensor(inputs), _whole(inputs, 1)
    own = [1] * (len(sizes) - values.ndim) + list(values.shape)
    lacking = [1] * (values.ndim - len(sizes)) + sizes
    return values.expand([max(pair) for pair in zip(own, lacking, strict=True)])


def _pad(inputs: Inputs, attributes: Attributes) -> Tensor:
    values, amounts, filled = _tensor(inputs), _whole(inputs, 1), _given(inputs, 2)
    if attributes.get("mode", b"constant") != b"constant" or _given(inputs, 3) is not None:
        raise ArtifactError("torch computes Pad only with zeros or a constant, and of all axes")
    before, after = amounts[: values.ndim], amounts[values.ndim :]
    # torch begins with the last axis.
    pairs = [side for both in zip(before[::-1], after[::-1], strict=True) for side in both]
    return functional.pad(values, pairs, value=0.0 if filled is None else filled.item())


def _split(inputs: Inputs, attributes: Attributes) -> Sequence[Tensor]:
    values, axis = _tensor(inputs), attributes.get("axis", 0)
    if _given(inputs, 1) is not None:
        return torch.split(values, _whole(inputs, 1), dim=axis)
    return torch.split(values, -(-values.shape[axis] // attributes["num_outputs"]), dim=axis)


def _slice(inputs: Inputs, _: Attributes) -> Tensor:
    values, starts, ends = _tensor(inputs), _whole(inputs, 1), _whole(inputs, 2)
    axes = range(len(starts)) if _given(inputs, 3) is None else _whole(inputs, 3)
    steps = [1] * len(starts) if _given(inputs, 4) is None else _whole(inputs, 4)
    index = [slice(None)] * values.ndim
    for axis, *bounds in zip(axes, starts, ends, steps, strict=True):
        index[axis] = slice(*bounds)
    return values[tuple(index)]


def _gather(inputs: Inputs, attributes: Attributes) -> Tensor:
    values, places = _tensor(inputs), _tensor(inputs, 1)
    axis = attributes.get("axis", 0) % values.ndim
    if not places.ndim:
        return values.select(axis, int(places))
    found = values.index_select(axis, (places.reshape(-1) % values.shape[axis]).to(values.device))
    return found.reshape(*values.shape[:axis], *places.shape, *values.shape[axis + 1 :])


RULES: Final[Mapping[str, Rule]] = {
    "Add": _elementwise(torch.add),
    "Sub": _elementwise(torch.sub),
    "Mul": _elementwise(torch.mul),
    "Div": _elementwise(torch.div),
    "MatMul": _elementwise(torch.matmul),
    "Relu": _elementwise(torch.relu),
    "Tanh": _elementwise(torch.tanh),
    "Sigmoid": _elementwise(torch.sigmoid),
    "Elu": lambda inputs, attributes: functional.elu(_tensor(inputs), attributes.get("alpha", 1.0)),
    "LeakyRelu": lambda inputs, attributes: functional.leaky_relu(
        _tensor(inputs), attributes.get("alpha", 0.01)
    ),
    "Softmax": lambda inputs, attributes: torch.softmax(_tensor(inputs), attributes.get("axis", -1)),
    "Gemm": _gemm,
    "Clip": _clip,
    "Gelu": _gelu,
    "LayerNormalization": _layer_normalisation,
    "ReduceSum": _reduce_sum,
    "Mean": _mean,
    "Concat": _concat,
    "Shape": _shape,
    "Reshape": _reshape,
    "Flatten": _flatten,
    "Squeeze": _squeeze,
    "Unsqueeze": _unsqueeze,
    "Transpose": _transpose,
    "Expand": _expand,
    "Pad": _pad,
    "Split": _split,
    "Slice": _slice,
    "Gather": _gather,
}

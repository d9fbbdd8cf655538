"""Every operation that a program takes, beside ONNX Runtime."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from taxel_server.runtimes.networks.graph import Unsupported, read_graph
from taxel_server.runtimes.networks.lowering import lower
from taxel_server.runtimes.networks.runtime import ProgramEvaluator

FEATURES = 24
GENERATOR = np.random.default_rng(0)

Build = Callable[["Model"], str]


class Model:
    """A small graph: window (n, 24) in, whatever a test makes of it, and a dense layer to 21 channels."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def __call__(self, operation: str, *inputs: str, outputs: int = 1, **attributes: Any) -> Any:
        names = [f"v{len(self.nodes)}_{place}" for place in range(outputs)]
        self.nodes.append(helper.make_node(operation, inputs, names, **attributes))
        return names[0] if outputs == 1 else names

    def constant(self, values: Any, kind: Any = np.float32) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.array(values, kind), name))
        return name

    def random(self, *shape: int) -> str:
        return self.constant(GENERATOR.normal(size=shape))

    def shaped(self, value: str, *shape: int) -> str:
        return self("Reshape", value, self.constant(shape, np.int64))

    def save(self, path: Path, last: str, width: int) -> Path:
        flat = self.shaped(last, -1, width)
        self.nodes.append(
            helper.make_node("Gemm", [flat, self.random(width, 21), self.random(21)], ["channels"])
        )
        graph = helper.make_graph(
            self.nodes,
            "test",
            [helper.make_tensor_value_info("window", TensorProto.FLOAT, ["n", FEATURES])],
            [helper.make_tensor_value_info("channels", TensorProto.FLOAT, ["n", 21])],
            self.constants,
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
        onnx.checker.check_model(model)
        onnx.save(model, path)
        return path


def attention(m: Model) -> str:
    """Queries of six tokens with two heads of two: split, transposed, and put together again."""
    tokens = m.shaped("window", -1, 6, 4)
    together = m("MatMul", tokens, m.random(4, 12))
    parts = m("Split", m.shaped(together, -1, 6, 6, 2), outputs=3, axis=2, num_outputs=3)
    queries, values = (m("Transpose", part, perm=[0, 2, 1, 3]) for part in parts[::2])
    keys = m("Transpose", parts[1], perm=[0, 2, 3, 1])
    attended = m("MatMul", m("Softmax", m("MatMul", queries, keys), axis=-1), values)
    return m.shaped(m("Transpose", attended, perm=[0, 2, 1, 3]), -1, 24)


def tokens(m: Model) -> str:
    return m.shaped("window", -1, 6, 4)


def of_positive(m: Model) -> str:
    return m("Add", m("Relu", "window"), m.constant(0.5))


SUPPORTED: dict[str, tuple[Build, int]] = {
    "a row added": (lambda m: m("Add", "window", m.random(FEATURES)), 24),
    "a row first": (lambda m: m("Mul", m.random(FEATURES), "window"), 24),
    "a number": (lambda m: m("Div", "window", m.constant(3.0)), 24),
    "one tensor and another": (lambda m: m("Sub", "window", m("Tanh", "window")), 24),
    "a row for every token": (lambda m: m("Sub", tokens(m), m.random(1, 4)), 24),
    "a tensor of tokens": (lambda m: m("Add", tokens(m), m.random(6, 4)), 24),
    "divided": (lambda m: m("Div", "window", of_positive(m)), 24),
    "one token for several": (
        lambda m: m("Mul", m.shaped(m("Gemm", "window", m.random(24, 4)), -1, 1, 4), m.random(3, 4)),
        12,
    ),
    "two values changed about": (
        lambda m: m("Add", m("Transpose", tokens(m), perm=[0, 2, 1]), m.random(4, 6)),
        24,
    ),
    "relu": (lambda m: m("Relu", "window"), 24),
    "leaky relu": (lambda m: m("LeakyRelu", "window", alpha=0.3), 24),
    "leaky relu's default": (lambda m: m("LeakyRelu", "window"), 24),
    "clip": (lambda m: m("Clip", "window", m.constant(-0.3), m.constant(0.6)), 24),
    "clip below": (lambda m: m("Clip", "window", m.constant(-0.3)), 24),
    "clip above": (lambda m: m("Clip", "window", "", m.constant(0.6)), 24),
    "tanh": (lambda m: m("Tanh", "window"), 24),
    "sigmoid": (lambda m: m("Sigmoid", "window"), 24),
    "elu": (lambda m: m("Elu", "window", alpha=0.5), 24),
    "elu's default": (lambda m: m("Elu", "window"), 24),
    "gelu": (lambda m: m("Gelu", "window"), 24),
    "gemm": (lambda m: m("Gemm", "window", m.random(24, 37), m.random(37)), 37),
    "gemm without bias": (lambda m: m("Gemm", "window", m.random(24, 37)), 37),
    "gemm transposed": (lambda m: m("Gemm", "window", m.random(70, 24), m.random(70), transB=1), 70),
    "gemm of tokens": (lambda m: m("Gemm", m.shaped("window", -1, 2), m.random(2, 5), m.random(5)), 60),
    "matmul of tokens": (lambda m: m("MatMul", tokens(m), m.random(4, 33)), 198),
    "matmul of tokens the other way round": (
        lambda m: m("MatMul", m("Transpose", tokens(m), perm=[0, 2, 1]), m.random(6, 3)),
        12,
    ),
    "matmul of two": (
        lambda m: m("MatMul", tokens(m), m("Transpose", tokens(m), perm=[0, 2, 1])),
        36,
    ),
    "matmul of a constant": (lambda m: m("MatMul", m.random(1, 5, 6), tokens(m)), 20),
    "matmul of two changed about": (
        lambda m: m("MatMul", m("Transpose", tokens(m), perm=[0, 2, 1]), tokens(m)),
        16,
    ),
    "attention": (attention, 24),
    "layer normalisation": (
        lambda m: m("LayerNormalization", tokens(m), m.random(4), m.random(4), axis=-1, epsilon=1e-3),
        24,
    ),
    "layer normalisation without bias": (
        lambda m: m("LayerNormalization", tokens(m), m.random(4), axis=2),
        24,
    ),
    "softmax": (lambda m: m("Softmax", tokens(m)), 24),
    "sum kept": (lambda m: m("ReduceSum", tokens(m), m.constant([1], np.int64), keepdims=1), 4),
    "sum of the last": (lambda m: m("ReduceSum", tokens(m), m.constant([-1], np.int64), keepdims=0), 6),
    "slice": (
        lambda m: m("Slice", "window", *(m.constant([at], np.int64) for at in (3, -2, 1))),
        19,
    ),
    "slice of several axes": (
        lambda m: m(
            "Slice", tokens(m), *(m.constant(at, np.int64) for at in ([1, 0], [5, 3], [1, 2], [1, 1]))
        ),
        12,
    ),
    "one place": (lambda m: m("Gather", tokens(m), m.constant(-1, np.int64), axis=1), 4),
    "unequal parts": (
        lambda m: m("Split", "window", m.constant([5, 19], np.int64), outputs=2, axis=1)[1],
        19,
    ),
    "put together": (lambda m: m("Concat", "window", m("Tanh", "window"), axis=1), 48),
    "put together from parts": (
        lambda m: m("Concat", *m("Split", "window", outputs=2, axis=1, num_outputs=2)[::-1], axis=-1),
        24,
    ),
    "padded": (lambda m: m("Pad", "window", m.constant([0, 3, 0, 1], np.int64)), 28),
    "flattened": (lambda m: m("Flatten", tokens(m)), 24),
    "unsqueezed": (lambda m: m("Unsqueeze", "window", m.constant([1], np.int64)), 24),
    "as many zeros": (
        lambda m: m("Add", "window", m("Expand", m.constant([[0.0]]), m("Shape", "window"))),
        24,
    ),
    "more buffers than fit in turn": (
        lambda m: m("Add", m("Mul", m("Tanh", "window"), m("Relu", "window")), m("Elu", "window")),
        24,
    ),
}


@pytest.mark.parametrize("name", SUPPORTED)
def test_an_operation_gives_what_onnx_runtime_gives(name: str, tmp_path: Path) -> None:
    build, width = SUPPORTED[name]
    model = Model()
    path = model.save(tmp_path / "model.onnx", build(model), width)
    program = ProgramEvaluator(lower(read_graph(path)))
    windows = np.random.default_rng(1).normal(size=(5, FEATURES)).astype(np.float32)
    (expected,) = onnxruntime.InferenceSession(path).run(None, {"window": windows})
    for _ in range(2):  # Nothing that an evaluation leaves behind reaches the next.
        result = np.full_like(expected, np.nan)
        program.evaluate(windows, result)
        np.testing.assert_allclose(result, expected, rtol=1e-5, atol=3e-6 * np.abs(expected).max())


UNSUPPORTED: dict[str, tuple[Build, int]] = {
    "another operation": (lambda m: m("Sin", "window"), 24),
    "an approximate gelu": (lambda m: m("Gelu", "window", approximate="tanh"), 24),
    "a scaled gemm": (lambda m: m("Gemm", "window", m.random(24, 5), alpha=0.5), 5),
    "computed weights": (
        lambda m: m("Gemm", "window", m("Transpose", m.shaped("window", 24, -1), perm=[0, 1])),
        1,
    ),
    "softmax over tokens": (lambda m: m("Softmax", tokens(m), axis=1), 24),
    "several places": (lambda m: m("Gather", "window", m.constant([4, 2], np.int64), axis=1), 2),
    "every other place": (
        lambda m: m("Slice", "window", *(m.constant([at], np.int64) for at in (0, 24, 1, 2))),
        12,
    ),
    "padded by ones": (
        lambda m: m("Pad", "window", m.constant([0, 0, 0, 1], np.int64), m.constant(1.0)),
        25,
    ),
    "rows put together": (lambda m: m("Concat", tokens(m), tokens(m), axis=2), 48),
    "both broadcast": (lambda m: m("Add", m.shaped("window", -1, 24, 1), m.random(1, 3)), 72),
    "a longer value taken away": (
        lambda m: m("Sub", m("ReduceSum", "window", m.constant([1], np.int64)), "window"),
        24,
    ),
}


def test_old_operators_are_refused(tmp_path: Path) -> None:
    """A softmax over all axes but the first, as it once was by default."""
    model = Model()
    path = model.save(tmp_path / "model.onnx", model("Softmax", "window"), 24)
    old = onnx.load(path)
    old.opset_import[0].version = 11
    onnx.save(old, path)
    with pytest.raises(Unsupported, match="operators of version 11"):
        read_graph(path)


@pytest.mark.parametrize("name", UNSUPPORTED)
def test_what_has_no_step_is_refused(name: str, tmp_path: Path) -> None:
    build, width = UNSUPPORTED[name]
    model = Model()
    path = model.save(tmp_path / "model.onnx", build(model), width)
    with pytest.raises(Unsupported):
        lower(read_graph(path))

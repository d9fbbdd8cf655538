"""Networks in torch: the served numbers, and gradients that finite differences agree with."""

import copy
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from onnx import helper

import taxel
import taxel.torch
from taxel import artifacts
from taxel.artifacts import Artifact
from taxel.channels import CHANNELS
from taxel.corrections import AppliedEffect, Parameter, Weighted
from taxel.errors import ArtifactError, InvalidArgument, NotFound
from taxel.local import shipped_repository
from taxel.torch.network import Network
from taxel.torch.operations import RULES
from taxel.torch.windows import newest_window
from taxel.windows import Samples, WindowSpec, WindowStream, build_windows
from taxel_bench.paper_size import write_paper_sized
from taxel_exporters.corrected import export_corrected
from taxel_exporters.onnx_int8 import with_int8_weights

NETWORKS = ("ffnn", "transformer", "network-a", "network-b")


def windows_of(artifact: Artifact, rows: int) -> NDArray[np.float32]:
    statistics = artifact.manifest.normalisation
    draws = np.random.default_rng(rows).normal(size=(rows, len(statistics.input_mean)))
    return (draws * statistics.input_std + statistics.input_mean).astype(np.float32)


def contacts(rows: int, seed: int, **options: Any) -> tuple[torch.Tensor, torch.Tensor]:
    random = np.random.default_rng(seed)
    position = random.normal([-0.003, 0.0, -0.006], 0.001, (rows, 3))
    force = random.normal([0.0, 0.0, 1.0], 0.3, (rows, 3))
    return torch.tensor(position, **options), torch.tensor(force, **options)


@pytest.mark.parametrize("name", NETWORKS)
def test_a_shipped_network_gives_the_served_numbers(name: str) -> None:
    network = taxel.torch.load(name)
    windows = windows_of(artifacts.read(shipped_repository() / name / "1"), 70)
    std = np.array(network.manifest.normalisation.output_std)
    with taxel.load(shipped_repository()) as source:
        predictor = source.predictor(name)
        for rows in (1, 70):
            served = predictor.predict(windows[:rows])
            assert (
                np.abs(network(torch.from_numpy(windows[:rows])).numpy() - served).max() < 1e-4 * std.min()
            )


def test_a_network_of_the_papers_size_gives_the_served_numbers(tmp_path: Path) -> None:
    write_paper_sized(tmp_path, "transformer", 8, seed=0)
    network = taxel.torch.load("transformer", repository=tmp_path)
    windows = windows_of(artifacts.read(tmp_path / "transformer" / "1"), 20)
    session = onnxruntime.InferenceSession(tmp_path / "transformer" / "1" / "model.onnx")
    expected = session.run(None, {"window": windows})[0]
    std = np.array(network.manifest.normalisation.output_std)
    assert np.abs(network(torch.from_numpy(windows)).numpy() - expected).max() < 1e-4 * std.min()


@pytest.mark.parametrize("name", NETWORKS)
def test_gradients_are_those_of_finite_differences(name: str) -> None:
    network = taxel.torch.load(name).double()
    position, force = contacts(2, seed=3, requires_grad=True)
    # Differences of metres must be small: torch's step is one for all inputs.
    assert torch.autograd.gradcheck(
        lambda place, push: network(network.window(place, push)),
        (position, force),
        eps=1e-7,
        rtol=1e-4,
        fast_mode=True,
    )


def test_gradients_reach_the_past(tmp_path: Path) -> None:
    write_paper_sized(tmp_path, "transformer", 8, seed=0)
    network = taxel.torch.load("transformer", repository=tmp_path).double()
    random = np.random.default_rng(0)
    position = torch.tensor(random.normal([0, 0, -0.007], 0.001, (2, 21, 3)), requires_grad=True)
    force = torch.tensor(random.normal(size=(2, 21, 3)), requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda place, push: network(network.window(place, push)),
        (position, force),
        eps=1e-7,
        rtol=1e-4,
        fast_mode=True,
    )


@settings(max_examples=25)
@given(
    combination=st.integers(1, 8),
    shift=st.integers(-3, 3),
    more=st.integers(0, 4),
    seed=st.integers(0, 2**31),
)
def test_windows_are_those_of_a_recording(combination: int, shift: int, more: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    spec = WindowSpec.of(combination, shift)
    count = spec.look_back + spec.look_ahead + 1 + more
    # Places that stand still for a while are what the last and the next one are about.
    position = np.repeat(random.normal(size=(count, 3)), random.integers(1, 9, count), axis=0)[:count]
    force = random.normal(size=(count, 3))
    times = np.arange(count) * 10_000_000
    built = build_windows(Samples.of(times, position, force), spec).values
    window = newest_window(spec, torch.tensor(position[None]), torch.tensor(force[None]))
    np.testing.assert_array_equal(window.numpy().astype(np.float32)[0], built[-1])


def test_a_steady_contact_needs_no_past() -> None:
    network = taxel.torch.load("transformer")
    position, force = contacts(5, seed=1)
    past = (each.unsqueeze(1).expand(-1, 30, -1) for each in (position, force))
    torch.testing.assert_close(network.window(position, force), network.window(*past))


@pytest.mark.parametrize("name", NETWORKS)
def test_nothing_stays_on_the_cpu(name: str) -> None:
    """The meta device has shapes without numbers, and refuses tensors of another device."""
    network = taxel.torch.load(name).to("meta")
    position, force = contacts(4, seed=1, device="meta", dtype=torch.float32)
    channels = network(network.window(position, force))
    assert (channels.device.type, channels.shape) == ("meta", (4, 21))


def test_a_network_is_copied_kept_and_mapped(tmp_path: Path) -> None:
    network = taxel.torch.load("network-b")
    windows = torch.from_numpy(windows_of(artifacts.read(shipped_repository() / "network-b" / "1"), 6))
    expected = network(windows)
    torch.testing.assert_close(copy.deepcopy(network)(windows), expected)
    torch.save(network, tmp_path / "network.pt")
    torch.testing.assert_close(torch.load(tmp_path / "network.pt", weights_only=False)(windows), expected)
    one_by_one = torch.vmap(lambda window: network(window[None])[0])(windows)
    torch.testing.assert_close(one_by_one, expected)


def model_of(text: str, **constants: Any) -> onnx.ModelProto:
    """A graph in ONNX's own language, from a window (n, 6)."""
    model = onnx.parser.parse_model(
        f'<ir_version: 10, opset_import: ["" : 20]> g (float[n,6] window) => (float channels) {{ {text} }}'
    )
    for name, values in constants.items():
        model.graph.initializer.append(onnx.numpy_helper.from_array(np.array(values), name))
    del model.graph.output[:]
    model.graph.output.append(helper.make_tensor_value_info("channels", onnx.TensorProto.FLOAT, None))
    return model


F = np.float32
OPERATIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "clip": ("channels = Clip(window, low)", {"low": F(-0.3)}),
    "clip on both sides": ("channels = Clip(window, low, high)", {"low": F(-0.3), "high": F(0.2)}),
    "tanh": ("channels = Tanh(window)", {}),
    "leaky relu": ("channels = LeakyRelu<alpha = 0.2>(window)", {}),
    "elu": ("channels = Elu<alpha = 0.7>(window)", {}),
    "approximate gelu": ('channels = Gelu<approximate = "tanh">(window)', {}),
    "gemm": (
        "channels = Gemm<transB = 1, alpha = 0.5, beta = 2.0>(window, w, b)",
        {"w": np.arange(12, dtype=F).reshape(2, 6), "b": np.array([1, 2], F)},
    ),
    "sum": ("channels = ReduceSum<keepdims = 0>(window, axes)", {"axes": [1]}),
    "mean": ("half = Tanh(window) channels = Mean(window, half)", {}),
    "split in equal parts": (
        "a, b, c = Split<axis = 1, num_outputs = 3>(window) channels = Concat<axis = 1>(c, a)",
        {},
    ),
    "split by sizes": (
        "a, b = Split<axis = 1>(window, sizes) channels = Concat<axis = 1>(b, a)",
        {"sizes": [2, 4]},
    ),
    "slice": (
        "channels = Slice(window, s, e, axes, steps)",
        {"s": [1], "e": [6], "axes": [1], "steps": [2]},
    ),
    "slice of the first axes": ("channels = Slice(window, s, e)", {"s": [0, -3], "e": [9, 99]}),
    "gather one": ("channels = Gather<axis = 1>(window, at)", {"at": np.array(-2)}),
    "gather some": ("channels = Gather<axis = 1>(window, at)", {"at": [[5, 0], [-1, 2]]}),
    "flatten": ("t = Reshape(window, s) channels = Flatten<axis = 1>(t)", {"s": [0, 3, -1]}),
    "reshape and transpose": (
        "t = Reshape(window, s) channels = Transpose<perm = [0, 2, 1]>(t)",
        {"s": [-1, 2, 3]},
    ),
    "squeeze": (
        "t = Unsqueeze(window, two) u = Squeeze(t, one) channels = Tanh(u)",
        {"two": [1, -1], "one": [3]},
    ),
    "pad": ("channels = Pad(window, by, filled)", {"by": [0, 2, 0, 1], "filled": F(0.5)}),
    "expand": (
        "s = Shape(window) t = Slice(window, a, b, one) channels = Expand(t, s)",
        {"a": [0], "b": [1], "one": [1]},
    ),
    "expand to fewer axes": (
        "t = Slice(window, a, b, one) channels = Expand(t, s)",
        {"a": [0], "b": [1], "one": [1], "s": [6]},
    ),
    "expand to more axes": ("channels = Expand(window, s)", {"s": [2, 1, 6]}),
    "part of a shape": (
        "s = Shape<start = 0, end = 1>(window) t = Concat<axis = 0>(s, two) channels = Reshape(window, t)",
        {"two": [2, 3]},
    ),
    "layer normalisation": (
        "channels = LayerNormalization<axis = -1, epsilon = 0.01>(window, w)",
        {"w": np.arange(6, dtype=F)},
    ),
    "softmax": ("channels = Softmax<axis = 1>(window)", {}),
}


def network_of(model: onnx.ModelProto, folder: Path) -> Network:
    onnx.save(model, folder / "model.onnx")
    network = taxel.torch.load("ffnn")
    layout = network.manifest.window
    manifest = network.manifest.model_copy(
        update={"window": layout.model_copy(update={"features": layout.features[:6]})}
    )
    return Network(Artifact(manifest, folder / "model.onnx"))


@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_gives_what_onnx_runtime_gives(name: str, tmp_path: Path) -> None:
    text, constants = OPERATIONS[name]
    model = model_of(text, **constants)
    network = network_of(model, tmp_path)
    windows = np.random.default_rng(0).normal(size=(5, 6)).astype(np.float32)
    expected = onnxruntime.InferenceSession(tmp_path / "model.onnx").run(None, {"window": windows})[0]
    np.testing.assert_allclose(network(torch.from_numpy(windows)).numpy(), expected, atol=1e-6, rtol=1e-6)


def test_every_operation_is_compared() -> None:
    compared = {node.op_type for text, _ in OPERATIONS.values() for node in model_of(text).graph.node}
    shipped = {
        node.op_type
        for name in NETWORKS
        for node in onnx.load(shipped_repository() / name / "1" / "model.onnx").graph.node
    }
    assert set(RULES) == compared | shipped


def test_what_torch_cannot_compute_is_told(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="xgb/1 is a model of trees: expected a network"):
        taxel.torch.load("xgb")
    with pytest.raises(NotFound, match="no model 'thumb'"):
        taxel.torch.load("thumb")
    rounded = with_int8_weights(onnx.load(shipped_repository() / "ffnn" / "1" / "model.onnx"))
    with pytest.raises(ArtifactError, match=r"com.microsoft.MatMulNBits: expected .* float32 weights"):
        network_of(rounded, tmp_path)
    old = model_of("channels = Tanh(window)")
    old.opset_import[0].version = 13
    with pytest.raises(ArtifactError, match="expected at least 18"):
        network_of(old, tmp_path)


def test_a_corrected_model_has_its_base(tmp_path: Path) -> None:
    shutil.copytree(shipped_repository() / "ffnn", tmp_path / "ffnn")
    term = Weighted(shape="unit", features=("fz",), references=(0.0,), weights=((3.0,) * 21,))
    effect = AppliedEffect(
        name="gain",
        about="Adds fz.",
        channels=CHANNELS,
        parameters=(Parameter(name="weight", value=3.0, unit="counts"),),
        terms=(term,),
        shift_ticks=2,
    )
    windows = windows_of(artifacts.read(tmp_path / "ffnn" / "1"), 8)
    export_corrected(tmp_path, "ffnn", "1", [effect], [], windows=windows)
    with pytest.raises(ArtifactError, match="ffnn/2 is corrected by gain: expected base=True"):
        taxel.torch.load("ffnn", repository=tmp_path)
    base = taxel.torch.load("ffnn", repository=tmp_path, base=True)
    with taxel.load(tmp_path) as source:
        expected = source.predictor("ffnn").predict_base(windows)
    np.testing.assert_allclose(base(torch.from_numpy(windows)).numpy(), expected, atol=0.01)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda n: n(torch.zeros(3, 11)), r"window has shape \(3, 11\): expected \(n, 12\)"),
        (lambda n: n.window(torch.zeros(3, 20, 3), torch.zeros(3, 20, 3)), "at least 21 ticks"),
        (lambda n: n.window(torch.zeros(3, 3), torch.zeros(2, 3)), r"force has shape \(2, 21, 3\)"),
        (
            lambda n: n.window(torch.zeros(3, 3), torch.zeros(3, 3), torch.zeros(3, 1)),
            r"extras has shape \(3, 1\): expected \(3, 0\)",
        ),
    ],
)
def test_a_wrong_shape_is_told(call: Any, said: str) -> None:
    with pytest.raises(InvalidArgument, match=said):
        call(taxel.torch.load("ffnn"))


def test_a_stream_is_told_of_a_tensor_with_gradients_and_goes_on() -> None:
    stream = WindowStream(WindowSpec.of(3))
    stream.push(0.0, [0, 0, 0], [0, 0, 1])
    force: Any = torch.zeros(3, requires_grad=True)
    with pytest.raises(InvalidArgument, match=r"force: .*detach.*: expected numbers on the CPU"):
        stream.push(0.01, [0, 0, 0], force)
    (window,) = stream.push(0.01, [1, 2, 3], [4, 5, 6])
    assert window.values.tolist() == [[1, 2, 3, 4, 5, 6]]

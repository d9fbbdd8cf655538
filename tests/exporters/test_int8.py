"""Weights of 8 bits: what rounding costs, and when it is refused."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import typer
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper
from typer.testing import CliRunner

import taxel
from taxel.errors import ArtifactError, SettingsError
from taxel_exporters import rounding
from taxel_exporters.commands import export as command
from taxel_exporters.export import export
from taxel_exporters.onnx_int8 import with_int8_weights
from taxel_exporters.weights import Weights
from taxel_models.training import trained as trained_models
from taxel_models.training.split import SplitSettings
from taxel_models.training.train import TrainingSettings

SaveTrained = Callable[[Path, TrainingSettings], Path]


@pytest.fixture(scope="module")
def dense_folder(save_trained: SaveTrained, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trained feed-forward network with one layer that is large enough to round."""
    overrides = {
        "neurons": [160, 100, 8],
        "activations": ["relu", "elu", "relu"],
        "epochs": 2,
        "patience": 0,
        "learning_rate": 0.001,
    }
    settings = TrainingSettings("ffnn", 1, SplitSettings("sessions"), overrides=overrides)
    return save_trained(tmp_path_factory.mktemp("dense") / "trained", settings)


def dense(weights: np.ndarray, *, transposed: bool) -> onnx.ModelProto:
    """One dense layer with a bias; weights (in, out)."""
    inputs, outputs = weights.shape
    stored = weights.T if transposed else weights
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["window", "w", "b"], ["channels"], transB=int(transposed))],
        "dense",
        [helper.make_tensor_value_info("window", TensorProto.FLOAT, ["n", inputs])],
        [helper.make_tensor_value_info("channels", TensorProto.FLOAT, ["n", outputs])],
        [
            numpy_helper.from_array(np.ascontiguousarray(stored), "w"),
            numpy_helper.from_array(np.arange(outputs, dtype=np.float32), "b"),
        ],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


def evaluate(model: onnx.ModelProto, windows: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(model.SerializeToString())
    return session.run(None, {"window": windows})[0]


@settings(max_examples=25, deadline=None)
@given(
    st.integers(64, 200),
    st.integers(64, 130),
    st.integers(1, 5),
    st.booleans(),
    st.floats(1e-3, 1e3),
    st.integers(0, 99),
)
def test_a_rounded_layer_is_within_what_8_bits_allow(
    inputs: int, outputs: int, rows: int, transposed: bool, size: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    weights = (rng.normal(size=(inputs, outputs)) * size).astype(np.float32)
    weights[: inputs // 2, 0] = 0
    windows = rng.normal(size=(rows, inputs)).astype(np.float32)
    exact = dense(weights, transposed=transposed)
    rounded = with_int8_weights(exact)
    assert [node.op_type for node in rounded.graph.node] == ["MatMulNBits"]
    # Half a step of either factor, of at most the largest weight and value, in every term.
    steps = np.abs(windows).max() * np.abs(weights).max() * inputs / 127
    np.testing.assert_allclose(evaluate(rounded, windows), evaluate(exact, windows), rtol=0, atol=steps)


def test_a_model_of_small_layers_is_refused() -> None:
    weights = np.random.default_rng(0).normal(size=(12, 200)).astype(np.float32)
    with pytest.raises(SettingsError, match="no layer takes and gives at least 64 values"):
        with_int8_weights(dense(weights, transposed=True))


def test_a_rounded_model_is_smaller_and_says_what_it_costs(dense_folder: Path, tmp_path: Path) -> None:
    exact = export(dense_folder, tmp_path, name="exact")
    manifest = export(dense_folder, tmp_path, name="rounded", weights=Weights.INT8)
    weights = manifest.rounded_weights
    assert weights is not None
    assert manifest.parity is None
    assert weights.float32_size == exact.model_file.size
    assert manifest.model_file.size < 0.6 * exact.model_file.size
    operations = [node.op_type for node in onnx.load(tmp_path / "rounded" / "1" / "model.onnx").graph.node]
    assert (operations.count("MatMulNBits"), operations.count("Gemm")) == (1, 2)
    trained = trained_models.load(dense_folder)
    assert weights.float32_norm_mae == pytest.approx(
        trained.record.training.metrics["test"]["norm_mae"], rel=1e-6
    )
    assert weights.norm_mae != weights.float32_norm_mae
    assert weights.rise <= 0.01
    card = (tmp_path / "rounded" / "1" / "README.md").read_text()
    assert f"normalised MAE is {weights.norm_mae:.4f}, with float32 weights" in card
    statistics = manifest.normalisation
    draws = np.random.default_rng(0).normal(size=(40, 12))
    windows = (draws * statistics.input_std + statistics.input_mean).astype(np.float32)
    with taxel.load(tmp_path) as source:
        assert source.predictor("rounded").manifest == manifest
        both = [source.predictor(name).predict(windows) for name in ("exact", "rounded")]
        alone = [source.predictor("rounded").predict(window[None]) for window in windows]
    assert 0 < np.abs(both[0] - both[1]).max() < np.max(statistics.output_std)
    # What else is in the batch changes nothing but the last bits of the sums.
    np.testing.assert_allclose(np.concatenate(alone), both[1], rtol=0, atol=0.01)


def test_the_same_training_gives_the_same_rounded_file(dense_folder: Path, tmp_path: Path) -> None:
    for repository in ("a", "b"):
        export(dense_folder, tmp_path / repository, weights=Weights.INT8)
    first, second = ((tmp_path / name / "ffnn" / "1" / "model.onnx").read_bytes() for name in "ab")
    assert first == second


def test_a_rise_of_the_error_is_refused_with_both_figures(
    dense_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rounding, "LARGEST_RISE", -0.5)
    message = r"normalised MAE \d\.\d+ on \d+ held-out windows, with float32 weights \d\.\d+ \([+-]"
    with pytest.raises(ArtifactError, match=message):
        export(dense_folder, tmp_path, weights=Weights.INT8)
    assert list(tmp_path.iterdir()) == []


def test_a_family_that_gains_nothing_is_refused(trained_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="for ffnn, network-a, network-b only, not for xgb"):
        export(trained_folder, tmp_path, weights=Weights.INT8)
    assert list(tmp_path.iterdir()) == []


def test_the_command_offers_it(dense_folder: Path, tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(command)
    arguments = [str(dense_folder), "--repository", str(tmp_path), "--weights", "int8"]
    said = CliRunner().invoke(app, arguments)
    assert said.exit_code == 0, said.output
    assert "Its weights are rounded to INT8: on" in said.output
    told = CliRunner().invoke(app, [*arguments, "--json"])
    assert json.loads(told.stdout)["rounded_weights"]["datatype"] == "INT8"
    foreign = CliRunner().invoke(app, [*arguments, "--from", "gazebo-plugin"])
    assert isinstance(foreign.exception, SettingsError)

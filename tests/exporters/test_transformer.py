"""The transformer's own graph against torch, for shapes that differ in every way that matters to it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from taxel_exporters.onnx_transformer import transformer_onnx
from taxel_models.families.networks.network import NetworkModel, Shape
from taxel_models.families.networks.transformer import TransformerFamily
from taxel_models.families.registry import resolve
from taxel_models.training import trained as trained_models
from taxel_models.training.trained import TrainedExtra, TrainedModel


@pytest.fixture(scope="module")
def trained(trained_folder: Path) -> TrainedModel:
    """A trained model, whose record says what the transformers below take."""
    return trained_models.load(trained_folder)


def with_transformer(trained: TrainedModel, layers: int, heads: int) -> TrainedModel:
    """The record of a trained model with a transformer of random weights."""
    family = TransformerFamily()
    chosen = resolve(
        family, 1, {"layers": layers, "heads": heads, "embedding": 12, "hidden": 20, "dropout": 0.3}
    )
    shape = Shape(trained.spec, extras=(), outputs=21)
    torch.manual_seed(layers * 10 + heads)
    network = family.build(shape, chosen)
    with torch.no_grad():
        # Fresh layer normalisations are all ones and zeros, and biases small.
        for parameter in network.parameters():
            parameter += 0.2 * torch.randn_like(parameter)
    return replace(trained, fitted=NetworkModel(network, shape, chosen))


def windows_of(trained: TrainedModel, rows: int) -> np.ndarray:
    statistics = trained.record.normalisation
    draws = np.random.default_rng(rows).normal(size=(rows, len(statistics.input_mean)))
    return (draws * statistics.input_std + statistics.input_mean).astype(np.float32)


def evaluate(model: onnx.ModelProto, windows: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(model.SerializeToString())
    return session.run(None, {"window": windows})[0]


@pytest.mark.parametrize("layers", [1, 2, 3])
@pytest.mark.parametrize("heads", [1, 3, 12])
def test_it_predicts_what_torch_does(trained: TrainedModel, layers: int, heads: int) -> None:
    model = with_transformer(trained, layers, heads)
    graph = transformer_onnx(model)
    for rows in (1, 2, 33):
        windows = windows_of(model, rows)
        expected = model.predict(windows)
        scale = np.abs(expected - model.record.normalisation.output_mean).max()
        np.testing.assert_allclose(evaluate(graph, windows), expected, rtol=0, atol=1e-5 * scale)


def test_a_temperature_that_others_take_is_left_alone(trained: TrainedModel) -> None:
    model = with_transformer(trained, layers=2, heads=2)
    temperature = TrainedExtra(name="tdc", served=True, mean=2000.0, std=10.0)
    beside = replace(model, record=model.record.model_copy(update={"extras": (temperature,)}))
    windows = windows_of(model, 5)
    expected = evaluate(transformer_onnx(model), windows)
    with_column = np.column_stack([windows, np.full(5, 1e6, np.float32)])
    np.testing.assert_array_equal(evaluate(transformer_onnx(beside), with_column), expected)


def test_the_last_block_computes_the_class_token_alone(trained: TrainedModel) -> None:
    """Dense layers behind the last attention see one row a window, whatever its length."""
    model = transformer_onnx(with_transformer(trained, layers=1, heads=3))
    widened = next(node.output[0] for node in model.graph.node if node.op_type == "Gelu")
    model.graph.output.append(onnx.helper.make_tensor_value_info(widened, onnx.TensorProto.FLOAT, None))
    session = onnxruntime.InferenceSession(model.SerializeToString())
    (hidden,) = session.run([widened], {"window": windows_of(trained, 4)})
    assert hidden.shape == (4, 20)

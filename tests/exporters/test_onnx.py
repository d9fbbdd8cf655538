"""ONNX files against the library that trained them: torch on networks, XGBoost on trees."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest

import taxel
from taxel.errors import ArtifactError
from taxel_exporters.export import export
from taxel_exporters.onnx_file import IR_VERSION, OPSET
from taxel_exporters.onnx_trees import trees_onnx
from taxel_models.training import trained as trained_models
from taxel_models.training.split import SplitSettings
from taxel_models.training.train import TrainingSettings
from taxel_models.training.trained import TrainedModel

SaveTrained = Callable[[Path, TrainingSettings], Path]

QUICK = {"epochs": 1, "patience": 0, "batch_size": 512, "learning_rate": 0.001}
NETWORKS: dict[str, dict[str, Any]] = {
    "ffnn": {"neurons": [24, 16, 8, 8], "activations": ["hardtanh", "leakyrelu", "elu", "relu"]},
    "transformer": {"layers": 2, "heads": 2, "embedding": 16, "hidden": 32},
    "network-a": {"widths": [16, 16]},
    "network-b": {
        "position_column": [8, 4],
        "force_column": [8, 4],
        "temperature_column": [4],
        "trunk": [8],
    },
}


def network(name: str, combination: int = 1, **changes: Any) -> TrainingSettings:
    overrides = {**NETWORKS[name], **QUICK}
    return TrainingSettings(name, combination, SplitSettings("sessions"), overrides=overrides, **changes)


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("combination", [1, pytest.param(8, marks=pytest.mark.long)])
def test_a_network_predicts_the_same_when_served(
    name: str, combination: int, save_trained: SaveTrained, tmp_path: Path
) -> None:
    folder = save_trained(tmp_path / "trained", network(name, combination))
    manifest = export(folder, tmp_path / "repository")
    assert manifest.platform == "onnxruntime_onnx"
    assert manifest.normalisation.folded
    assert manifest.parity is not None
    assert manifest.parity.largest_difference < 0.01
    trained = trained_models.load(folder)
    statistics = manifest.normalisation
    draws = np.random.default_rng(0).normal(size=(70, len(statistics.input_mean)))
    windows = (draws * statistics.input_std + statistics.input_mean).astype(np.float32)
    with taxel.load(tmp_path / "repository") as source:
        predictor = source.predictor(name)
        for rows in (1, 7, 70):
            np.testing.assert_allclose(
                predictor.predict(windows[:rows]), trained.predict(windows[:rows]), rtol=0, atol=0.01
            )


def test_a_measured_temperature_is_a_named_input_with_a_default(
    save_trained: SaveTrained, tmp_path: Path
) -> None:
    folder = save_trained(tmp_path / "trained", network("network-b", extras="measured"))
    manifest = export(folder, tmp_path / "repository")
    (extra,) = manifest.window.extras
    assert (extra.name, manifest.window.features[-1]) == ("tdc", "tdc")
    trained = trained_models.load(folder)
    windows = np.tile(np.float32(manifest.normalisation.input_mean[:12]), (3, 1))
    hot = np.full(3, extra.default + 50, np.float32)
    with taxel.load(tmp_path / "repository") as source:
        predictor = source.predictor("network-b")
        np.testing.assert_allclose(predictor.predict(windows), trained.predict(windows), atol=0.01)
        given = predictor.predict(np.column_stack([windows, hot]))
    np.testing.assert_allclose(given, trained.predict(windows, {"tdc": hot}), atol=0.01)
    assert np.abs(given - trained.predict(windows)).max() > 0.1


def test_the_file_is_pinned_plain_and_whole(save_trained: SaveTrained, tmp_path: Path) -> None:
    folder = save_trained(tmp_path / "trained", network("transformer"))
    export(folder, tmp_path / "a")
    export(folder, tmp_path / "b")
    first, second = (tmp_path / name / "transformer" / "1" / "model.onnx" for name in "ab")
    assert first.read_bytes() == second.read_bytes()
    model = onnx.load(first)
    assert (model.ir_version, model.opset_import[0].version) == (IR_VERSION, OPSET)
    assert not any(
        tensor.HasField("data_location") and tensor.data_location for tensor in model.graph.initializer
    )
    assert str(Path.cwd()).encode() not in first.read_bytes()
    assert b"site-packages" not in first.read_bytes()


@pytest.fixture(scope="module")
def trees(trained_folder: Path) -> TrainedModel:
    return trained_models.load(trained_folder)


def evaluate(model: onnx.ModelProto, windows: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(model.SerializeToString())
    return session.run(None, {"window": windows})[0]


def test_trees_as_onnx_take_the_same_branches_on_thresholds_and_nan(trees: TrainedModel) -> None:
    """Inputs that equal thresholds to the bit, one step beside them, and missing values."""
    model = trees_onnx(trees)
    (ensemble,) = [node for node in model.graph.node if node.op_type == "TreeEnsembleRegressor"]
    attributes = {attribute.name: attribute for attribute in ensemble.attribute}
    cuts = np.array(attributes["nodes_values"].floats, np.float32)
    used = np.array(attributes["nodes_featureids"].ints)
    rng = np.random.default_rng(0)
    z_scores = rng.normal(size=(3000, 12)).astype(np.float32)
    for feature in range(12):
        own = cuts[(used == feature) & (cuts != 0)]
        if len(own):
            z_scores[:, feature] = rng.choice(
                np.concatenate([own, np.nextafter(own, -9), np.nextafter(own, 9)]), 3000
            )
    z_scores[rng.random(z_scores.shape) < 0.1] = np.nan
    # Skip the normalisation, so that the thresholds are hit exactly.
    tree_graph = onnx.helper.make_graph(
        [ensemble],
        "trees",
        [onnx.helper.make_tensor_value_info("columns", onnx.TensorProto.FLOAT, ["n", 12])],
        [onnx.helper.make_tensor_value_info("z_scores", onnx.TensorProto.FLOAT, ["n", 21])],
    )
    alone = onnx.helper.make_model(tree_graph, opset_imports=model.opset_import, ir_version=IR_VERSION)
    session = onnxruntime.InferenceSession(alone.SerializeToString())
    found = session.run(None, {"columns": z_scores})[0]
    np.testing.assert_allclose(found, trees.fitted.predict(z_scores), rtol=0, atol=2e-6)


def test_trees_as_onnx_are_exported_on_request(trained_folder: Path, tmp_path: Path) -> None:
    manifest = export(trained_folder, tmp_path, name="trees", model_format="onnx")
    assert manifest.platform == "onnxruntime_onnx"
    assert manifest.parity is not None
    assert manifest.parity.largest_difference < 0.01
    with pytest.raises(ArtifactError, match="expected one of xgboost, onnx"):
        export(trained_folder, tmp_path, model_format="pmml")

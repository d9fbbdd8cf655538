"""Ensembles: trained together, exported as one file, served with the spread of their members."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import msgpack
import numpy as np
import pytest

import taxel
from taxel.errors import InvalidArgument, SettingsError
from taxel.protocol import pack_infer_request, unpack_infer_request
from taxel_exporters.export import export
from taxel_models.families.registry import family, resolve
from taxel_models.training import trained as trained_models
from taxel_models.training.split import SplitSettings
from taxel_models.training.train import TrainingSettings
from taxel_models.training.trained import TrainedModel
from taxel_server.transports.memory import MemoryServer

SaveTrained = Callable[[Path, TrainingSettings], Path]

OVERRIDES = {
    "members": "ffnn:2,network-b:1,xgb:1",
    "ffnn.neurons": [16, 8],
    "ffnn.activations": ["relu", "relu"],
    "ffnn.epochs": 2,
    "network-b.epochs": 1,
    "xgb.n_estimators": 5,
    "xgb.max_depth": 3,
}


@pytest.fixture(scope="module")
def repository(save_trained: SaveTrained, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A repository with an ensemble of three families, and the model it was exported from."""
    folder = tmp_path_factory.mktemp("ensemble")
    settings = TrainingSettings("ensemble", 1, SplitSettings("sessions"), overrides=OVERRIDES)
    manifest = export(save_trained(folder / "trained", settings), folder / "repository")
    assert manifest.gives_spread
    return folder / "repository"


@pytest.fixture(scope="module")
def trained(repository: Path) -> TrainedModel:
    return trained_models.load(repository.parent / "trained")


@pytest.fixture
def windows(trained: TrainedModel) -> np.ndarray:
    statistics = trained.record.normalisation
    draws = np.random.default_rng(0).normal(size=(40, 12))
    return (draws * statistics.input_std + statistics.input_mean).astype(np.float32)


def test_the_prediction_is_the_mean_of_the_members_and_the_spread_their_deviation(
    repository: Path, trained: TrainedModel, windows: np.ndarray
) -> None:
    statistics = trained.record.normalisation
    z_scores = (windows - np.float32(statistics.input_mean)) / np.float32(statistics.input_std)
    each = np.stack([model.predict(z_scores) for _, model in trained.fitted.members])
    counts = each * np.float32(statistics.output_std) + np.float32(statistics.output_mean)
    with taxel.load(repository) as source:
        channels, spread = source.predictor("ensemble").predict_with_spread(windows)
    np.testing.assert_allclose(channels, counts.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(spread, counts.std(axis=0), atol=0.01)


def test_members_of_a_family_differ_by_their_seed(trained: TrainedModel, windows: np.ndarray) -> None:
    (_, first), (_, second), *_ = trained.fitted.members
    assert (first.predict(windows) != second.predict(windows)).any()
    assert [name for name, _ in trained.fitted.members] == ["ffnn", "ffnn", "network-b", "xgb"]


def test_remote_and_local_agree_on_the_spread(repository: Path, windows: np.ndarray) -> None:
    with MemoryServer(repository) as memory, taxel.connect(transport=memory) as server:
        remote = server.predictor("ensemble")
        found = remote.predict_with_spread(windows)
        alone = remote.predict(windows)

        async def awaited() -> tuple[np.ndarray, np.ndarray]:
            async with taxel.connect_async(transport=memory) as source:
                predictor = await source.predictor("ensemble")
                return await predictor.predict_with_spread(windows)

        for awaited_values, values in zip(asyncio.run(awaited()), found, strict=True):
            np.testing.assert_array_equal(awaited_values, values)
    with taxel.load(repository) as source:
        expected = source.predictor("ensemble").predict_with_spread(windows)
    for remote_values, local_values in zip(found, expected, strict=True):
        np.testing.assert_allclose(remote_values, local_values, rtol=1e-6, atol=1e-4)
    np.testing.assert_array_equal(alone, found[0])


def test_a_measured_temperature_reaches_only_the_members_that_take_it(
    save_trained: SaveTrained, tmp_path: Path
) -> None:
    settings = TrainingSettings(
        "ensemble", 1, SplitSettings("sessions"), overrides=OVERRIDES, extras="measured"
    )
    manifest = export(save_trained(tmp_path / "trained", settings), tmp_path / "repository")
    assert manifest.window.features[-1] == "tdc"
    assert manifest.parity is not None
    assert manifest.parity.largest_difference < 0.01


def test_a_single_model_gives_no_spread(trained_folder: Path, tmp_path: Path) -> None:
    export(trained_folder, tmp_path)
    windows = np.zeros((1, 12), np.float32)
    with taxel.load(tmp_path) as source, pytest.raises(InvalidArgument, match="gives no spread"):
        source.predictor("xgb").predict_with_spread(windows)
    with MemoryServer(tmp_path) as memory, taxel.connect(transport=memory) as server:
        with pytest.raises(InvalidArgument, match="gives no spread"):
            server.predictor("xgb").predict_with_spread(windows)
        request = pack_infer_request(windows, spread=True)
        with pytest.raises(InvalidArgument, match=r"outputs\[1\]: xgb/1 gives no spread"):
            server.get("taxel/v2/models/xgb/infer", request)


@pytest.mark.parametrize(
    "outputs", ["spread", [{}], [{"name": "spread"}], [1], [], [{"name": "channels"}] * 3]
)
def test_odd_outputs_in_a_request_are_refused(outputs: object) -> None:
    request = msgpack.unpackb(pack_infer_request(np.zeros((1, 12), np.float32)))
    with pytest.raises(InvalidArgument, match="outputs: "):
        unpack_infer_request(msgpack.packb({**request, "outputs": outputs}))


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({}, "needs members"),
        ({"members": "ffnn:1"}, "members"),
        ({"members": "ffnn:none"}, "expected FAMILY:COUNT"),
        ({"members": "svm:2"}, "expected one of"),
        ({"members": "ensemble:2"}, "expected FAMILY:COUNT"),
        ({"members": "ffnn:2", "ffnn.epoch": 3}, "epoch"),
        ({"members": "ffnn:2", "xgb.eta": 0.1}, r"xgb\.eta"),
    ],
)
def test_impossible_ensembles_are_refused(overrides: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        resolve(family("ensemble"), 1, overrides)

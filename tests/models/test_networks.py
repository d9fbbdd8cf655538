"""The network families: sizes as published, training as published, deterministic and resumable."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.nn import functional

from taxel.errors import ArtifactError, InvalidArgument, SettingsError, TaxelError
from taxel.windows import COMBINATIONS, WindowSpec
from taxel_models.families.networks import recipe, sizes
from taxel_models.families.networks.network import NetworkFamily, NetworkModel, Shape
from taxel_models.families.registry import family, resolve
from taxel_models.recordings import Recording
from taxel_models.training import trained as trained_models
from taxel_models.training.train import TrainingSettings, train

Make = Callable[..., Recording]

CONTRADICTIONS = {("ffnn", 2), ("ffnn", 6), ("transformer", 2), ("transformer", 6)}
"""Cells of the inference table that the paper's own hyperparameter table does not give."""

SMALL: dict[str, dict[str, Any]] = {
    "ffnn": {"neurons": [16, 8, 4], "activations": ["tanh", "leakyrelu", "relu"]},
    "transformer": {"layers": 1, "heads": 2, "embedding": 8, "hidden": 16},
    "network-a": {"widths": [16, 16]},
    "network-b": {
        "position_column": [8, 4],
        "force_column": [8, 4],
        "temperature_column": [4],
        "trunk": [8],
    },
}
QUICK = {"epochs": 4, "patience": 2, "batch_size": 256, "learning_rate": 0.01}


def network(name: str, combination: int) -> torch.nn.Module:
    kind = family(name)
    assert isinstance(kind, NetworkFamily)
    return kind.build(kind.shape(WindowSpec.of(combination), kind.extras), resolve(kind, combination, {}))


def settings(name: str, **changes: Any) -> TrainingSettings:
    return TrainingSettings(
        **{"model": name, "combination": 1, "overrides": {**SMALL[name], **QUICK}, **changes}
    )


@pytest.fixture
def recording(make_recording: Make) -> Recording:
    return make_recording([250] * 24)


@pytest.mark.parametrize("combination", COMBINATIONS)
@pytest.mark.parametrize("name", sizes.COMPARED)
def test_parameter_counts_come_out_of_the_architecture(name: str, combination: int) -> None:
    assert sizes.agrees(name, combination) == ((name, combination) not in CONTRADICTIONS)


def test_the_documents_table_is_the_computed_one() -> None:
    document = Path(__file__).resolve().parents[2] / "docs" / "models.md"
    assert sizes.markdown() in document.read_text()


def test_network_a_has_over_six_million_parameters_in_five_hidden_layers() -> None:
    layers = [layer for layer in network("network-a", 1).modules() if isinstance(layer, torch.nn.Linear)]
    assert len(layers) == 5 + 1
    assert (layers[0].in_features, layers[-1].out_features) == (13, 23)
    assert sum(part.numel() for part in network("network-a", 1).parameters()) > 6_000_000


def test_the_encoder_is_torchs_own_pre_norm_block() -> None:
    """One block against `nn.TransformerEncoderLayer` with the same weights."""
    encoder = network("transformer", 1).eval()
    block = encoder.blocks[0]
    peer = torch.nn.TransformerEncoderLayer(
        128, 4, 512, 0.0, functional.gelu, batch_first=True, norm_first=True
    ).eval()
    pairs = {
        "self_attn.in_proj_weight": "queries_keys_values.weight",
        "self_attn.in_proj_bias": "queries_keys_values.bias",
        "self_attn.out_proj.weight": "attended.weight",
        "self_attn.out_proj.bias": "attended.bias",
        **{f"linear1.{part}": f"widen.{part}" for part in ("weight", "bias")},
        **{f"linear2.{part}": f"narrow.{part}" for part in ("weight", "bias")},
        **{f"norm1.{part}": f"before_attention.{part}" for part in ("weight", "bias")},
        **{f"norm2.{part}": f"before_dense.{part}" for part in ("weight", "bias")},
    }
    weights = block.state_dict()
    peer.load_state_dict({theirs: weights[ours] for theirs, ours in pairs.items()})
    tokens = torch.randn(7, 5, 128, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        torch.testing.assert_close(block(tokens), peer(tokens), rtol=1e-4, atol=1e-5)


def test_network_b_is_position_times_force_plus_temperature() -> None:
    kind = family("network-b")
    shape = Shape(WindowSpec.of(7), ("tdc",), 23)
    torch.manual_seed(0)
    built = kind.build(shape, resolve(kind, 7, SMALL["network-b"]))
    columns = torch.randn(5, 19, generator=torch.Generator().manual_seed(1))
    place, force = built.position_column(columns[:, :9]), built.force_column(columns[:, 9:18])
    expected = built.trunk(place * force) + built.temperature_column(columns[:, 18:])
    torch.testing.assert_close(built(columns), expected)


def test_the_loss_is_the_published_one() -> None:
    predicted, expected = torch.tensor([[1.0, -2.0]]), torch.tensor([[0.5, 1.0]])
    assert recipe.loss_of(predicted, expected).item() == pytest.approx((0.5 + 3.0 + 0.25 + 9.0) / 2)


@pytest.mark.parametrize("name", SMALL)
def test_every_family_learns_keeps_and_reads_back(name: str, recording: Recording, tmp_path: Path) -> None:
    overrides = {**SMALL[name], **QUICK, "epochs": 25, "patience": 0}
    model, kept = train([recording], settings(name, overrides=overrides))
    metrics = model.record.training.metrics
    assert metrics["test"]["norm_mae"] < 0.9 * metrics["mean_predictor"]["norm_mae"]
    history = model.record.history
    assert len(history.train) == len(history.validation) == 25
    assert history.validation[history.best - 1] == min(history.validation)
    trained_models.save(model, kept, tmp_path / "trained")
    assert (tmp_path / "trained" / "loss.png").stat().st_size > 1000
    back = trained_models.load(tmp_path / "trained")
    windows = np.random.default_rng(0).normal(size=(50, 12)).astype(np.float32)
    np.testing.assert_array_equal(back.predict(windows), model.predict(windows))
    (tmp_path / "trained" / "weights" / "weights.pt").write_bytes(b"damage")
    with pytest.raises(ArtifactError, match=f"not a {name} network"):
        trained_models.load(tmp_path / "trained")


def test_the_same_seed_gives_the_same_network(recording: Recording) -> None:
    first, again, other = (train([recording], settings("ffnn", seed=seed))[0] for seed in (1, 1, 2))
    windows = np.random.default_rng(0).normal(size=(50, 12)).astype(np.float32)
    np.testing.assert_array_equal(first.predict(windows), again.predict(windows))
    assert (first.predict(windows) != other.predict(windows)).any()


def test_an_interrupted_training_goes_on_as_if_it_had_not_been(
    recording: Recording, tmp_path: Path
) -> None:
    class Interrupted(Exception):
        pass

    def interrupt(done: float, note: str) -> None:
        if note.startswith("epoch 2"):
            raise Interrupted

    checkpoint = tmp_path / "checkpoint"
    overrides = {**SMALL["transformer"], **QUICK, "dropout": 0.2}
    whole, _ = train([recording], settings("transformer", overrides=overrides))
    with pytest.raises(Interrupted):
        train([recording], settings("transformer", overrides=overrides, checkpoint=checkpoint), interrupt)
    assert checkpoint.exists()
    resumed, _ = train([recording], settings("transformer", overrides=overrides, checkpoint=checkpoint))
    assert resumed.record == whole.record
    assert not checkpoint.exists()


def test_a_checkpoint_of_another_training_is_not_taken(recording: Recording, tmp_path: Path) -> None:
    checkpoint = tmp_path / "checkpoint"

    def keep_a_copy(done: float, note: str) -> None:
        if checkpoint.exists() and not (tmp_path / "copy").exists():
            (tmp_path / "copy").write_bytes(checkpoint.read_bytes())

    train([recording], settings("ffnn", checkpoint=checkpoint), keep_a_copy)
    alone, _ = train([recording], settings("ffnn", seed=5))
    (tmp_path / "copy").rename(checkpoint)
    beside, _ = train([recording], settings("ffnn", seed=5, checkpoint=checkpoint))
    assert beside.record == alone.record


def test_a_damaged_checkpoint_is_passed_over(
    recording: Recording, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    checkpoint = tmp_path / "checkpoint"
    checkpoint.write_bytes(b"damage")
    beside, _ = train([recording], settings("ffnn", checkpoint=checkpoint))
    alone, _ = train([recording], settings("ffnn"))
    assert beside.record == alone.record
    assert "training starts again" in caplog.text


def test_a_training_that_diverges_says_so(recording: Recording) -> None:
    overrides = {**SMALL["ffnn"], **QUICK, "learning_rate": 1e30}
    with pytest.raises(TaxelError, match=r"the loss is .* in epoch \d: .* lower the learning rate"):
        train([recording], settings("ffnn", overrides=overrides))


def test_early_stopping_keeps_the_best_weights(recording: Recording) -> None:
    overrides = {**SMALL["ffnn"], **QUICK, "epochs": 60, "patience": 2, "learning_rate": 0.3}
    model, _ = train([recording], settings("ffnn", overrides=overrides))
    history = model.record.history
    assert len(history.validation) == history.best + 2 < 60
    assert history.validation[history.best - 1] == min(history.validation)


@pytest.mark.parametrize("use", ["measured", "mean", "none"])
def test_what_becomes_of_the_temperature(use: Any, recording: Recording) -> None:
    model, _ = train([recording], settings("network-b", extras=use))
    assert isinstance(model.fitted, NetworkModel)
    assert model.fitted.extras == (() if use == "none" else ("tdc",))
    assert [extra.name for extra in model.served_extras] == (["tdc"] if use == "measured" else [])
    assert model.layout.features[-1] == ("tdc" if use == "measured" else "fz[+10]")
    metrics = model.record.training.metrics
    if use == "none":
        assert "test_measured_temperature" not in metrics
    else:
        assert metrics["test_measured_temperature"] != metrics["test_mean_temperature"]
        assert metrics["test"] == metrics[f"test_{use}_temperature"]


def test_what_0_1_kept_of_the_temperature_is_read(recording: Recording, tmp_path: Path) -> None:
    model, kept = train([recording], settings("network-b", extras="measured"))
    folder = tmp_path / "trained"
    trained_models.save(model, kept, folder)
    record = json.loads((folder / "trained.json").read_text())
    (extra,) = record.pop("extras")
    assert extra.pop("name") == "tdc"
    (folder / "trained.json").write_text(json.dumps({**record, "temperature": extra}))
    place = folder / "weights" / "network.json"
    kept = json.loads(place.read_text())
    assert kept.pop("extras") == ["tdc"]
    place.write_text(json.dumps({**kept, "temperature": True}))
    back = trained_models.load(folder)
    assert back.record == model.record
    windows = np.random.default_rng(0).normal(size=(5, 12)).astype(np.float32)
    warm = {"tdc": np.linspace(1000, 2000, 5, dtype=np.float32)}
    np.testing.assert_array_equal(back.predict(windows, warm), model.predict(windows, warm))
    assert (back.predict(windows, warm) != back.predict(windows)).any()
    (folder / "trained.json").write_text(json.dumps({**record, "temperature": None}))
    assert trained_models.load(folder).record.extras == ()


def test_an_extra_that_the_model_does_not_take_is_refused(recording: Recording) -> None:
    windows, values = np.zeros((2, 12), np.float32), np.zeros(2, np.float32)
    model, _ = train([recording], settings("network-b", extras="measured"))
    with pytest.raises(InvalidArgument, match=r"extras \['tcd'\]: expected \['tdc'\]"):
        model.predict(windows, {"tdc": values, "tcd": values})
    without, _ = train([recording], settings("network-b", extras="none"))
    with pytest.raises(InvalidArgument, match=r"extras \['tdc'\]: expected none"):
        without.predict(windows, {"tdc": values})


def test_the_auxiliary_channels_are_fitted_but_not_served(recording: Recording) -> None:
    model, _ = train([recording], settings("network-b"))
    assert model.fitted.shape.outputs == 23
    assert model.predict(np.zeros((2, 12), np.float32)).shape == (2, 21)


def test_the_published_script_is_offered_beside_the_text() -> None:
    kind = family("transformer")
    text = resolve(kind, 1, {})
    script = resolve(kind, 1, {"optimizer": "adamw", "milestones": [100, 150]})
    assert (text.model_dump()["optimizer"], text.model_dump()["patience"]) == ("adam", 8)
    assert script.model_dump()["milestones"] == (100, 150)


@pytest.mark.parametrize(
    ("name", "overrides", "message"),
    [
        ("transformer", {"heads": 3}, "not a multiple of 3 heads"),
        ("ffnn", {"activations": ["relu"]}, "1 activations for 7 widths"),
        ("network-b", {"force_column": [8, 5]}, "cannot multiply"),
        ("ffnn", {"optimizer": "sgd"}, "optimizer"),
    ],
)
def test_impossible_networks_are_refused(name: str, overrides: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        resolve(family(name), 1, overrides)


def test_progress_tells_the_current_losses(recording: Recording) -> None:
    notes: list[str] = []
    train([recording], settings("ffnn"), lambda done, note: notes.append(note))
    assert all("train" in note and "validation" in note for note in notes)

"""Artifacts of the published size with random weights: they are not trained, but as fast."""

import hashlib
from pathlib import Path
from typing import Any, Final

import numpy as np

from taxel import __version__
from taxel.artifacts import MANIFEST, manifest_json
from taxel.channels import CHANNELS
from taxel.errors import SettingsError
from taxel.manifest import Manifest, ModelFile, Normalisation, Platform, Training, WindowLayout, tensors
from taxel.windows import WindowSpec
from taxel_bench.forests import TreeShape, tree_shape, write_forest
from taxel_models.families.registry import family, resolve

PAPER_MODELS: Final = ("xgb", "ffnn", "transformer", "network-b", "network-a")


def write_paper_sized(
    repository: Path, model: str, combination: int, *, seed: int, trees: TreeShape = "even"
) -> Path:
    """Write an artifact with the paper's hyperparameters for an input combination.

    Args:
        model: one of `PAPER_MODELS`.
        trees: how the trees of `xgb` grow; see `taxel_bench.forests`.

    Returns:
        The artifact's folder.

    Raises:
        SettingsError: there is no such model.
    """
    if model not in PAPER_MODELS:
        raise SettingsError(f"--model {model}: the paper's size is known of {', '.join(PAPER_MODELS)}")
    folder = repository / model / "1"
    folder.mkdir(parents=True)
    if model == "xgb":
        _write_forest(folder, combination, seed, trees)
    else:
        _write_network(folder, model, combination, seed)
    return folder


def _write_forest(folder: Path, combination: int, seed: int, trees: TreeShape) -> None:
    spec = WindowSpec.of(combination)
    path = folder / "model.json"
    nodes = write_forest(path, tree_shape(trees, combination), seed)
    training = _training("xgb", resolve(family("xgb"), combination, {}).model_dump(mode="json"), seed)
    layout = WindowLayout.of(spec)
    statistics = _statistics(spec.length, seed)
    _write_manifest(folder, "xgboost_json", path.name, layout, statistics, nodes, training)


def _write_network(folder: Path, model: str, combination: int, seed: int) -> None:
    # Not for a forest: torch takes seconds to import.
    import torch

    from taxel_exporters import formats
    from taxel_models.families.family import History
    from taxel_models.families.networks.network import NetworkFamily, NetworkModel
    from taxel_models.training.trained import TrainedExtra, TrainedModel, TrainedRecord

    kind = family(model)
    assert isinstance(kind, NetworkFamily)
    spec = WindowSpec.of(combination)
    chosen = resolve(kind, combination, {})
    shape = kind.shape(spec, kind.extras)
    torch.manual_seed(seed)
    network = NetworkModel(kind.build(shape, chosen), shape, chosen)
    record = TrainedRecord(
        combination=combination,
        parameters=network.parameters,
        normalisation=_statistics(spec.length, seed),
        extras=tuple(TrainedExtra(name=name, served=False, mean=0.0, std=1.0) for name in kind.extras),
        training=_training(model, chosen.model_dump(mode="json"), seed),
        history=History(unit="epoch", loss="none", train=(), validation=(), best=0, notes={}),
        taxel_version=__version__,
    )
    trained = TrainedModel(record, network)
    exported = formats.write(trained)
    (folder / exported.file_name).write_bytes(exported.content)
    statistics = trained.served_normalisation.model_copy(update={"folded": exported.folded})
    _write_manifest(
        *(folder, exported.platform, exported.file_name, trained.layout, statistics),
        *(network.parameters, record.training),
    )


def _training(model: str, hyperparameters: dict[str, Any], seed: int) -> Training:
    return Training(
        family=model, data=(), windows={}, split={}, seed=seed, hyperparameters=hyperparameters, metrics={}
    )


def _statistics(features: int, seed: int) -> Normalisation:
    """Statistics as if of data: not 0 and 1, which a graph optimiser would drop."""
    generator = np.random.default_rng(seed)
    input_mean, output_mean = generator.normal(size=features), generator.normal(size=len(CHANNELS))
    input_std, output_std = generator.uniform(1, 3, features), generator.uniform(20, 200, len(CHANNELS))
    return Normalisation(
        input_mean=tuple(input_mean.tolist()),
        input_std=tuple(input_std.tolist()),
        output_mean=tuple(output_mean.tolist()),
        output_std=tuple(output_std.tolist()),
    )


def _write_manifest(
    folder: Path,
    platform: Platform,
    file_name: str,
    layout: WindowLayout,
    statistics: Normalisation,
    parameters: int,
    training: Training,
) -> None:
    content = (folder / file_name).read_bytes()
    inputs, outputs = tensors(layout)
    manifest = Manifest(
        name=folder.parent.name,
        version=folder.name,
        description="Random weights at the published size, for benchmarks: it predicts nothing.",
        platform=platform,
        inputs=inputs,
        outputs=outputs,
        window=layout,
        normalisation=statistics,
        parameters=parameters,
        training=training,
        model_file=ModelFile(name=file_name, sha256=hashlib.sha256(content).hexdigest(), size=len(content)),
        taxel_version=__version__,
    )
    (folder / MANIFEST).write_text(manifest_json(manifest), encoding="utf-8")

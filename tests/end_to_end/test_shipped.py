"""The artifacts that come with Taxel."""

import numpy as np
import pytest

import taxel
from taxel.artifacts import folder_of, read
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.shipped import shipped_repository
from taxel_models.training.dataset import examples
from taxel_models.twin import simulate

FAMILIES = ("ffnn", "network-a", "network-b", "transformer", "xgb")


def test_there_is_a_small_one_of_each_family() -> None:
    repository = shipped_repository()
    with taxel.load(repository) as source:
        offered = source.models()
    assert [(model.name, model.state) for model in offered] == [(name, "READY") for name in FAMILIES]
    size = sum(path.stat().st_size for path in repository.rglob("*") if path.is_file())
    assert size < 40_000_000


@pytest.mark.parametrize("name", FAMILIES)
def test_each_says_what_it_is_and_does_it(name: str) -> None:
    folder = folder_of(shipped_repository(), name)
    manifest = read(folder).manifest
    assert manifest.training is not None
    assert [source.name for source in manifest.training.data] == ["twin"]
    assert "simulated fingertip: not of a real sensor" in (folder / "README.md").read_text()
    unseen = simulate(70_000, 99).rows(slice(60_000, None))
    found = examples(unseen, manifest.spec)
    with taxel.load(shipped_repository()) as source:
        predicted = source.predictor(name).predict(found.windows)
    std = manifest.normalisation.output_std
    mean = np.broadcast_to(np.float32(manifest.normalisation.output_mean), predicted.shape)
    ours, baseline = (ErrorMetrics.of(found.channels, each, std).norm_mae for each in (predicted, mean))
    assert ours < 0.6 * baseline

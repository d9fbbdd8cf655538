"""The artifacts that come with Taxel."""

import numpy as np
import pytest

import taxel
from taxel.artifacts import folder_of, read
from taxel.predictor import DEFAULT_MODEL
from taxel.skin import Fingertip
from taxel_models.evaluation.metrics import ErrorMetrics
from taxel_models.shipped import shipped_repository
from taxel_models.training.dataset import examples
from taxel_models.twin import simulate

FAMILIES = ("ffnn", "network-a", "network-b", "transformer", "xgb")
NAMES = tuple(name for family in FAMILIES for name in (family, f"{family}-causal"))


def test_there_is_a_small_one_of_each_family_and_a_causal_one() -> None:
    repository = shipped_repository()
    with taxel.load(repository) as source:
        offered = source.models()
    assert [(model.name, model.state) for model in offered] == [(name, "READY") for name in NAMES]
    for model in offered:
        assert model.delay_s == (0.0 if model.name.endswith("-causal") else 0.1)
        assert model.norm_mae is not None
    size = sum(path.stat().st_size for path in repository.rglob("*") if path.is_file())
    assert size < 40_000_000


def test_the_default_is_causal_and_knows_its_training() -> None:
    with taxel.load() as source:
        manifest = source.predictor().manifest
    assert manifest.name == DEFAULT_MODEL
    assert manifest.spec.delay_s == 0.0
    assert manifest.held_out_residual is not None
    assert manifest.training is not None
    contacts = manifest.training.contacts
    assert contacts is not None
    assert (contacts.skin_radius, contacts.on_skin) == (Fingertip.biotac_2p().radius, 1.0)
    assert contacts.period_ms == 10.0


@pytest.mark.parametrize("name", NAMES)
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

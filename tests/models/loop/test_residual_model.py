"""What no effect explains is predicted where it can be, and served as fitted; noise is left alone."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel.corrections import Correction, RandomFeatures
from taxel_models.loop import residual_model as module
from taxel_models.loop.attribution import Attribution
from taxel_models.loop.blocks import Blocks, cut
from taxel_models.loop.correction import NewEffects, corrected
from taxel_models.loop.observations import Observations, gather
from taxel_models.loop.residual_model import LIMIT, ResidualModel, residual_model
from taxel_models.recordings import Recording

Make = Callable[..., Recording]

BENT: Final = slice(2, 8)
"""Channels whose gain about a bend depends on the material."""


@pytest.fixture(scope="module", autouse=True)
def _small() -> Iterator[None]:
    """Fewer cosines are enough here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "COSINES", 64)
        patch.setattr(module, "COSINES_TRIED", 64)
        yield


def nothing_named(observations: Observations) -> Attribution:
    return Attribution(observations, (), (), observations.residual)


def fitted(observations: Observations, blocks: Blocks, **others: Any) -> ResidualModel | None:
    return residual_model(
        observations, nothing_named(observations), blocks, observations.residual, **others
    )


@pytest.fixture(scope="module")
def observations(smooth: Any, make: Make) -> Observations:
    recording = make()
    pressed = np.linalg.norm(recording.samples.force, axis=1)
    material = recording.covariates["material"]
    channels = recording.channels.copy()
    channels[:, BENT] += ((material - 3.0) * 40.0 * pressed / (1.0 + pressed**2))[:, None]
    return gather(smooth, [replace(recording, channels=channels)])


@pytest.fixture(scope="module")
def blocks(observations: Observations) -> Blocks:
    return cut(observations, seed=0)


@pytest.fixture(scope="module")
def found(observations: Observations, blocks: Blocks) -> ResidualModel:
    model = fitted(observations, blocks)
    assert model is not None
    return model


def test_the_error_falls_where_nothing_was_fitted_and_elsewhere_nothing_is_added(
    observations: Observations, blocks: Blocks, found: ResidualModel
) -> None:
    np.testing.assert_array_equal(np.flatnonzero(found.has[BENT]), np.arange(6))
    assert found.has.sum() <= 8
    assert any(extra.name.startswith("material=") for extra in found.extras)
    new = found.added_to(NewEffects((), ()))
    after = corrected(observations, nothing_named(observations), new)
    np.testing.assert_array_equal(after[:, ~found.has], observations.predicted[:, ~found.has])
    told = found.found(observations, blocks, observations.predicted, after)
    gains = {gain.channel: gain for gain in told.channels}
    for name in CHANNELS[BENT]:
        assert gains[name].evaluation > 0.5 * gains[name].folds > gains[name].error
    rows = blocks.evaluation
    before, now = (
        np.abs(observations.measured - counts)[rows][:, BENT].mean()
        for counts in (observations.predicted, after)
    )
    assert now < 0.8 * before


def test_what_is_served_is_what_was_measured(observations: Observations, found: ResidualModel) -> None:
    new = found.added_to(NewEffects((), ()))
    offline = corrected(observations, nothing_named(observations), new)
    rows = np.arange(0, len(observations), 50)
    names = [extra.name for extra in found.extras]
    extras = [
        observations.history(extra.history)
        if extra.history is not None
        else observations.covariates["material"] == float(extra.name.partition("=")[2])
        for extra in found.extras
    ]
    windows = np.column_stack([observations.windows, *extras]).astype(np.float32)[rows]
    assert names
    manifest = observations.manifest
    served = Correction(new.effects, manifest.spec, (*manifest.window.model_extras, *new.extras)).apply(
        observations.model.predict, windows
    )
    np.testing.assert_allclose(served, offline[rows], atol=0.01)
    again = RandomFeatures.model_validate_json(found.effect.terms[0].model_dump_json())
    assert again == found.effect.terms[0]


def test_far_from_what_was_recorded_it_stays_bounded(found: ResidualModel) -> None:
    (term,) = found.effect.terms
    assert isinstance(term, RandomFeatures)
    most = np.abs(term.weights).sum(axis=0) + np.abs(term.constants)
    for far in (-1e30, 1e30):
        columns = {name: np.full(3, far) for name in term.features}
        delta = term.delta(np.full((3, 21), far), columns)
        assert (np.abs(delta) <= most).all()
    assert term.limit == LIMIT


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_noise_has_no_residual_model(smooth: Any, make: Make, seed: int) -> None:
    observations = gather(smooth, [make(seed=seed)])
    found = fitted(observations, cut(observations, seed=seed), seed=seed)
    assert found is None or found.has.sum() <= 1


def test_an_excluded_column_is_not_taken(observations: Observations, blocks: Blocks) -> None:
    found = fitted(observations, blocks, exclude=("covariate:material",))
    assert found is None or not any(extra.name.startswith("material=") for extra in found.extras)

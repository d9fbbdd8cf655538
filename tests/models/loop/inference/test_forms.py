"""Forms are scaled to the residual; one less its mean is served as it was fitted."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taxel.channels import CHANNELS
from taxel.corrections import AppliedEffect, Correction
from taxel.windows import WindowSpec
from taxel_models.loop.basis import Own
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Candidate, Fitting, Remaining, about_mean
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.loop.inference.forms import prepared
from taxel_models.loop.inference.whitening import Bins, NoiseShape, Whitening
from taxel_models.loop.observations import Observations

ADDING = ("offset", "gain", "drift", "temperature", "creep", "hysteresis", "rate", "location", "crosstalk")


@pytest.fixture(scope="module")
def whitening(observations: Observations) -> Whitening:
    bins = Bins.of(cut(observations, seed=0), DECLARED.bin_s)
    return Whitening(bins, NoiseShape.usual(), observations.residual, DECLARED)


def forms_of(observations: Observations, name: str) -> list[Candidate]:
    (effect,) = [one for one in candidates(observations) if one.label == name]
    rows = len(observations)
    remaining = Remaining(observations.residual, np.ones(rows, bool), np.ones(rows))
    return list(effect.forms(observations, remaining))


@pytest.mark.parametrize("name", [*ADDING, "covariate:material"])
def test_a_weight_of_one_changes_a_channel_by_its_residual(
    observations: Observations, whitening: Whitening, name: str
) -> None:
    for candidate in forms_of(observations, name)[:4]:
        for form in prepared(candidate, whitening):
            means = whitening.bins.of_basis(form.candidate.basis)
            size = np.sqrt((means**2).mean(axis=1)) / form.unit
            prior = 1.0 if candidate.fitting.prior is None else candidate.fitting.prior
            relative = np.broadcast_to(size / whitening.scale[:, None], form.unit.shape) / prior
            moved = np.isfinite(form.unit)
            if candidate.fitting.pooled:
                allowed = candidate.fitting.allowed
                some = relative[slice(None) if allowed is None else allowed]
                np.testing.assert_allclose((some**2).mean(axis=0), 1.0)
            else:
                np.testing.assert_allclose(relative[moved], 1.0)
            assert (form.weights(np.ones_like(form.unit))[~moved] == 0.0).all()


def test_figures_are_counted_by_channel_unless_all_share_them(
    observations: Observations, whitening: Whitening
) -> None:
    forms = [next(prepared(one, whitening)) for one in forms_of(observations, "gain")[:3]]
    assert [one.freedom for one in forms] == [1, 1, 21]
    alike, _, own = forms
    fixed = replace(alike.candidate, fitting=Fitting(fixed=True, beforehand=3))
    assert next(prepared(fixed, whitening)).freedom == 3
    course = replace(own.candidate, fitting=Fitting(beforehand=5))
    assert next(prepared(course, whitening)).freedom == 26


def test_only_a_form_with_a_mean_has_another_without_it(
    observations: Observations, whitening: Whitening
) -> None:
    names = {
        name: [len(list(prepared(candidate, whitening))) for candidate in forms_of(observations, name)]
        for name in ("offset", "gain", "rate", "hysteresis")
    }
    assert names["offset"] == [1]
    assert names["gain"][0] == 2
    for candidate in forms_of(observations, "hysteresis"):
        for form in list(prepared(candidate, whitening))[1:]:
            assert form.candidate.form.endswith(", about its mean")
            means = whitening.bins.of_basis(form.candidate.basis).mean(axis=1)
            np.testing.assert_allclose(means, 0.0, atol=1e-9)


def test_a_form_less_its_mean_differs_by_a_constant_of_each_channel(observations: Observations) -> None:
    random = np.random.default_rng(0)
    for name in ("gain", "creep", "hysteresis", "covariate:material"):
        for candidate in forms_of(observations, name)[:3]:
            size = candidate.basis.size
            weights = random.normal(size=(len(CHANNELS), size))
            means = candidate.basis.at(np.arange(len(observations))).mean(axis=1)
            other = about_mean(candidate, means)
            plain, less = candidate.basis.times(weights), other.basis.times(weights)
            np.testing.assert_allclose(less.mean(axis=0), 0.0, atol=1e-6)
            np.testing.assert_allclose(np.ptp(plain - less, axis=0), 0.0, atol=1e-6)
            rows = np.array([0, 700, 4000])
            np.testing.assert_allclose(other.basis.at(rows), candidate.basis.at(rows) - means[:, None])
            assert other.basis.size == size


@pytest.mark.parametrize("name", ["gain", "creep", "hysteresis", "rate", "location", "covariate:material"])
def test_what_is_served_is_what_is_added(smooth: Any, observations: Observations, name: str) -> None:
    for candidate in forms_of(observations, name)[-2:]:
        means = candidate.basis.at(np.arange(len(observations))).mean(axis=1)
        other = about_mean(candidate, means)
        weights = np.random.default_rng(1).normal(size=(len(CHANNELS), candidate.basis.size))
        online = other.online(weights)
        applied = AppliedEffect(name=name, about="", channels=CHANNELS, parameters=(), terms=online.terms)
        taken = smooth.manifest.window
        extras = (*taken.extras, *online.extras)
        correction = Correction((applied,), WindowSpec.of(taken.combination, 0), extras)
        values = [
            observations.covariates["material"] == float(extra.name.partition("=")[2])
            if extra.history is None
            else observations.history(extra.history)
            for extra in online.extras
        ]
        windows = np.column_stack([observations.windows, *values]).astype(np.float32)
        added = correction.apply(smooth.predict, windows) - observations.predicted
        expected = other.basis.times(weights)
        np.testing.assert_allclose(added, expected, atol=2e-5 * max(np.abs(expected).max(), 100.0))


def test_a_form_for_other_predictions_keeps_its_means(observations: Observations) -> None:
    candidate = forms_of(observations, "gain")[1]
    means = candidate.basis.at(np.arange(len(observations))).mean(axis=1)
    other = about_mean(candidate, means)
    assert other.again is not None
    shifted = replace(observations, predicted=observations.predicted + 1, base=observations.base + 1)
    weights = np.ones((len(CHANNELS), 1))
    before, after = other.basis.times(weights), other.again(shifted).basis.times(weights)
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_a_channel_that_the_regressors_do_not_move_has_no_weight(
    observations: Observations, whitening: Whitening
) -> None:
    values = np.random.default_rng(0).normal(size=(len(observations), 21, 1)).astype(np.float32)
    values[:, 5] = 0.0
    form = next(prepared(Candidate("some", "form", Own(values)), whitening))
    weights = form.weights(np.ones((21, 1)))
    assert weights[5, 0] == 0.0
    assert (np.delete(weights, 5) > 0).all()
    assert np.isfinite(form.design.values).all()

"""The motion of inputs that explains a residual, beside the weights of named effects."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from taxel.windows import WindowSpec
from taxel_models.loop.basis import Shared
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Remaining
from taxel_models.loop.effects.frame import FrameEffect
from taxel_models.loop.effects.rigid_motion import KINDS, Misfit, after, fit_motion, turn_of
from taxel_models.loop.observations import Observations
from taxel_models.model import predict_all

TURN = np.radians(15.0) * np.array([0.6, 0.0, 0.8])


@pytest.fixture(scope="module")
def turned(observations: Observations) -> np.ndarray:
    """(n, 21) what a turn of the forces adds, counts."""
    windows = turn_of("force", TURN).turn(observations.windows, observations.manifest.spec)
    return np.asarray(predict_all(observations.model.predict, windows) - observations.predicted)


def remaining(observations: Observations, residual: np.ndarray, **others: Any) -> Remaining:
    return Remaining(residual, cut(observations, seed=0).fit, np.ones(len(observations)), **others)


def angle(observations: Observations, left: Remaining) -> float:
    """Between the motion that is found and the one that was, in degrees."""
    found = fit_motion(observations, left)
    assert found is not None
    kind, vector, _ = found
    assert kind == "force"
    return float(np.degrees((Rotation.from_rotvec(vector).inv() * Rotation.from_rotvec(TURN)).magnitude()))


def test_a_motion_is_found_though_named_effects_took_a_part_of_it(
    observations: Observations, turned: np.ndarray
) -> None:
    """A named effect follows the force, as the turn does, and its weights were fitted first."""
    regressors = np.column_stack([observations.windows[:, -3:], observations.pressed])
    weights, *_ = np.linalg.lstsq(regressors, turned, rcond=None)
    left = turned - regressors @ weights
    assert (left**2).sum() < 0.5 * (turned**2).sum()
    beside = [Shared(regressors.astype(np.float64))]
    assert angle(observations, remaining(observations, turned)) < 0.1
    assert angle(observations, remaining(observations, left)) > 5.0
    assert angle(observations, remaining(observations, left, beside=beside)) < 0.5


def test_what_named_effects_explain_is_no_misfit(observations: Observations, turned: np.ndarray) -> None:
    """As a regression by least squares leaves it, in each channel, with its rows weighted."""
    random = np.random.default_rng(1)
    rows, counted = np.arange(0, 600), random.uniform(0.5, 2.0, len(observations))
    features = random.normal(size=(len(observations), 3))
    shape = random.normal(size=turned.shape)
    residual = turned + features @ random.normal(size=(3, 21)) * shape
    left = Remaining(residual, np.ones(len(turned), np.bool_), counted, beside=[Shared(features, shape)])
    misfit = Misfit(observations, left, "force", rows)
    roots = np.sqrt(counted[rows])
    for channel in (0, 7):
        values = roots[:, None] * features[rows] * shape[rows, channel, None]
        own = roots * residual[rows, channel]
        expected = own - values @ np.linalg.lstsq(values, own, rcond=None)[0]
        scale = np.sqrt((residual[rows, channel] ** 2).mean())
        np.testing.assert_allclose(misfit.target[:, channel], expected / scale, atol=1e-9)


@pytest.mark.parametrize(("begins", "ages"), [(0.0, [False]), (0.5, [False, True])])
def test_a_motion_that_was_there_from_the_start_is_not_said_to_have_come_about(
    observations: Observations, turned: np.ndarray, begins: float, ages: list[bool]
) -> None:
    """Errors that grow in the session are explained by its last part a little better."""
    session = np.linspace(0.0, 1.0, len(observations))
    noise = np.random.default_rng(2).normal(size=turned.shape) * turned.std(axis=0)
    residual = (session >= begins)[:, None] * turned * (1.0 + 0.3 * session[:, None]) + 0.3 * noise
    forms = list(FrameEffect().forms(observations, remaining(observations, residual)))
    # Each is weighed whole, and in its slow part.
    assert [form.ages for form in forms] == [each for each in ages for _ in range(2)]


def test_the_slow_part_of_a_motion_is_its_mean_over_a_second_of_a_segment(
    observations: Observations, turned: np.ndarray
) -> None:
    whole, slow = FrameEffect().forms(observations, remaining(observations, turned))
    change, means = whole.basis.at(np.arange(len(turned))), slow.basis.at(np.arange(len(turned)))
    (segment,) = np.unique(observations.segment)
    assert segment == 0
    for row in (50, 1_000, 4_321):
        expected = change[:, row - 50 : row + 51].mean(axis=1)
        np.testing.assert_allclose(means[:, row], expected, atol=1e-3)


@pytest.mark.parametrize(
    ("kind", "vector", "precise"),
    [("zero", (0.3, -0.8, 0.5), 0.05), ("scale", (0.2,), 0.02), ("scale", (-0.45,), 0.02)],
)
def test_a_force_sensors_zero_and_gain_are_found(
    observations: Observations, kind: str, vector: tuple[float, ...], precise: float
) -> None:
    windows = turn_of(kind, np.array(vector)).turn(observations.windows, observations.manifest.spec)
    change = predict_all(observations.model.predict, windows) - observations.predicted
    noise = np.random.default_rng(3).normal(size=change.shape) * change.std(axis=0)
    found = fit_motion(observations, remaining(observations, change + noise))
    assert found is not None
    assert found[0] == kind
    np.testing.assert_allclose(found[1], vector, atol=precise)


@given(seed=st.integers(0, 999))
def test_two_motions_together_do_what_they_do_one_after_the_other(seed: int) -> None:
    random, spec = np.random.default_rng(seed), WindowSpec.of(3)
    windows = random.normal(size=(4, spec.length)).astype(np.float32)
    motions = [
        turn_of(kind, random.normal(size=1 if kind == "scale" else 3) / 3)
        for kind in random.permutation(KINDS)
    ]
    expected, whole = windows, turn_of("shift", np.zeros(3))
    for motion in motions:
        expected, whole = motion.turn(expected, spec), after(motion, whole)
    np.testing.assert_allclose(whole.turn(windows, spec), expected, atol=1e-5)

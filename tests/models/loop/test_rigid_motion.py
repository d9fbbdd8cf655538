"""The motion of inputs that explains a residual, beside the weights of named effects."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from taxel_models.loop.basis import Shared
from taxel_models.loop.blocks import cut
from taxel_models.loop.effects.effect import Remaining
from taxel_models.loop.effects.frame import FrameEffect
from taxel_models.loop.effects.rigid_motion import LEAST_SCALE, MOTION_KINDS, Misfit, fit_motion
from taxel_models.loop.observations import Observations
from taxel_models.model import predict_all

FORCES_TURNED = MOTION_KINDS[0]
TURN = np.radians(15.0) * np.array([0.6, 0.0, 0.8])


@pytest.fixture(scope="module")
def turned(observations: Observations) -> np.ndarray:
    """(n, 21) what a turn of the forces adds, counts."""
    windows = FORCES_TURNED.frame(TURN).turn(observations.windows, observations.manifest.spec)
    return np.asarray(predict_all(observations.model.predict, windows) - observations.predicted)


def remaining(observations: Observations, residual: np.ndarray, **others: Any) -> Remaining:
    return Remaining(residual, cut(observations, seed=0).fit, np.ones(len(observations)), **others)


def angle(observations: Observations, left: Remaining) -> float:
    """Between the motion that is found and the one that was, in degrees."""
    found = fit_motion(observations, left)
    assert found is not None
    assert found.kind is FORCES_TURNED
    return float(
        np.degrees((Rotation.from_rotvec(found.vector).inv() * Rotation.from_rotvec(TURN)).magnitude())
    )


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
    misfit = Misfit(observations, left, rows)
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
    [
        ("forces shifted", (0.3, -0.8, 0.5), 0.05),
        ("forces scaled", (0.2,), 0.02),
        ("forces scaled", (-0.45,), 0.02),
        ("forces mirrored", (0.0, 0.0, 0.0), 0.05),
        ("both mirrored alike", (0.0, 0.0, 3.1), 0.05),
        ("positions shifted", (0.001, -0.006, 0.002), 0.001),
    ],
)
def test_what_was_wrong_with_the_inputs_is_found(
    observations: Observations, kind: str, vector: tuple[float, ...], precise: float
) -> None:
    (motion,) = [one for one in MOTION_KINDS if one.name == kind]
    windows = motion.frame(np.array(vector)).turn(observations.windows, observations.manifest.spec)
    change = predict_all(observations.model.predict, windows) - observations.predicted
    noise = np.random.default_rng(3).normal(size=change.shape) * change.std(axis=0)
    found = fit_motion(observations, remaining(observations, change + noise))
    assert found is not None
    assert found.kind is motion
    np.testing.assert_allclose(found.vector, vector, atol=precise)


class OfSurfaces:
    """A model that knows a few heights, as a forest that was trained on a few surfaces."""

    def __init__(self, model: Any, column: int, heights: np.ndarray) -> None:
        self.manifest, self._model, self._column, self._heights = model.manifest, model, column, heights

    def predict(self, windows: np.ndarray) -> np.ndarray:
        nearest = np.abs(windows[:, self._column, None] - self._heights).argmin(axis=1)
        return np.asarray(self._model.predict(windows) + 300.0 * np.cos(2.0 * nearest)[:, None], np.float32)


def test_a_shift_is_found_where_no_small_step_leads_to_it(observations: Observations) -> None:
    heights = observations.position[:, 2].mean() + np.array([-2, -1, 0, 1, 2]) * 1e-3
    rows = np.arange(len(observations))
    position = observations.position.copy()
    position[:, 2] = heights[rows // 50 % 5]
    spec = observations.manifest.spec
    windows = observations.windows.copy()
    columns = range(2, 3 * len(spec.positions), 3)
    windows[:, columns] = position[:, 2, None]
    model: Any = OfSurfaces(observations.model, columns[0], heights)
    true = model.predict(windows)
    windows[:, columns] += 0.0045
    position[:, 2] += 0.0045
    moved = replace(
        observations, model=model, windows=windows, position=position, predicted=model.predict(windows)
    )
    found = fit_motion(moved, remaining(moved, true - moved.predicted))
    assert found is not None
    assert found.kind.name == "positions shifted"
    np.testing.assert_allclose(found.vector[2], -0.0045, atol=5e-4)


def test_a_mirror_is_told_by_its_normal() -> None:
    (kind,) = [one for one in MOTION_KINDS if one.name == "positions mirrored"]
    turned = kind.parameters(np.radians([0.0, 0.0, 180.0]))
    # x is mirrored, then x and y are: y is left.
    assert [round(abs(turned[f"mirrored axis {axis}"][0]), 6) for axis in "xyz"] == [0, 1, 0]
    assert turned["angle"] == (pytest.approx(0.0, abs=1e-4), "deg")
    about = kind.parameters(np.radians([30.0, 0.0, 0.0]))
    assert about["mirrored axis x"][0] == pytest.approx(1.0)
    assert about["angle"] == (pytest.approx(30.0), "deg")


def test_what_is_reported_is_what_is_applied() -> None:
    reported = {kind.name: kind.parameters(np.full(kind.starts.shape[1], -0.95)) for kind in MOTION_KINDS}
    assert reported["forces shifted"]["force x"] == (-0.95, "N")
    assert reported["positions shifted"]["x"] == (pytest.approx(-950.0), "mm")
    assert reported["both turned alike"]["angle"] == (pytest.approx(np.degrees(0.95 * np.sqrt(3))), "deg")
    # A scale ends above 0.
    assert reported["forces scaled"]["force scale"] == (LEAST_SCALE, "")

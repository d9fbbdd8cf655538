"""The twin's geometry and contact law."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxel.skin import gap_to_skin, height_above_skin, patch
from taxel_models.twin.fluid import THINNEST, counts_of, log_impedance, pocketed, thickness
from taxel_models.twin.sensor import Sensor
from taxel_models.twin.skin import FLUID_LIMIT_N, Skin, fluid_force, sunk_share

SENSOR = Sensor.biotac_2p()
SKIN = Skin.of(SENSOR)


def test_the_electrodes_sit_inside_the_skin_and_look_out() -> None:
    heights = height_above_skin(SENSOR.positions, SENSOR.skin_radius)
    assert SENSOR.positions.shape == (19, 3)
    assert (heights < -1.0).all()
    np.testing.assert_allclose(np.linalg.norm(SENSOR.normals, axis=1), 1.0)
    np.testing.assert_allclose(height_above_skin(SKIN.feet, SENSOR.skin_radius), 0.0, atol=1e-9)


def test_there_is_more_fluid_over_the_tip() -> None:
    assert SKIN.fluid[6:10].mean() > 1.2 * np.delete(SKIN.fluid, range(6, 10)).mean()


@given(along=st.floats(-14, 10), around=st.floats(-2, 2), height=st.floats(-3, 30))
def test_height_is_measured_along_the_normal(along: float, around: float, height: float) -> None:
    place = patch(np.array([along]), np.array([around]), SENSOR.skin_radius)
    frame = np.concatenate([place.normal, place.forward, place.sideways])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    raised = place.point + height * place.normal
    np.testing.assert_allclose(height_above_skin(raised, SENSOR.skin_radius), height, atol=1e-9)


def test_the_gap_of_a_point_on_the_axis_is_the_radius() -> None:
    gap = gap_to_skin(np.array([[-5.0, 0, 0], [0, 0, 0]]), np.array([[0, 1.0, 0], [1.0, 0, 0]]), 7.0)
    np.testing.assert_allclose(gap, 7.0)


def test_the_contact_law_meets_its_own_definition() -> None:
    force = np.linspace(0.05, 12.0, 200)
    sunk = sunk_share(force)
    np.testing.assert_allclose(FLUID_LIMIT_N * sunk**1.5 / (1 - sunk**2), force, rtol=1e-3)


def test_the_fluid_carries_a_monotone_share_with_a_knee_near_2_newtons() -> None:
    force = np.linspace(0.0, 10.0, 1001)
    carried = fluid_force(force)
    assert (np.diff(carried) > 0).all()
    slope = np.gradient(carried, force)
    assert slope[50] > 2.5 * slope[300]
    assert carried[200] > 0.55 * carried[-1]
    assert carried[50] / 0.5 == pytest.approx(carried[100] / 1.0, rel=0.25)


@given(counts=st.floats(100, 4000))
def test_counts_and_impedance_are_each_others_inverse(counts: float) -> None:
    assert counts_of(log_impedance(np.array([counts])))[0] == pytest.approx(counts)


def test_impedance_is_the_manuals() -> None:
    assert np.exp(log_impedance(np.array([4095 / 2])))[0] == pytest.approx(10.0)


def relative_thickness(
    place: int, dented: float, shear: tuple[float, float, float] = (0, 0, 0)
) -> np.ndarray:
    squared = SKIN.squared_distances(SKIN.feet[[place]])
    normal = SENSOR.normals[[place]]
    return thickness(SENSOR, SKIN, squared, normal, np.array([dented]), np.array([shear]))[0]


@pytest.mark.parametrize("place", range(19))
def test_a_pressed_electrode_loses_fluid_that_far_ones_gain(place: int) -> None:
    film = relative_thickness(place, 0.6)
    far = SKIN.squared_distances(SKIN.feet[[place]])[0] > 10.0**2
    assert film.argmin() == place
    assert film[place] < 0.7
    assert (film[far] > 1.0).all()


def test_no_film_is_thinner_than_the_skins_texture() -> None:
    assert relative_thickness(0, 5.0).min() == THINNEST


def test_shear_thickens_one_side_and_thins_the_other() -> None:
    film = relative_thickness(16, 0.0, shear=(0.0, 1.0, 0.0))
    assert (film[10:16] > 1.0).all()
    assert (film[:6] < 1.0).all()
    assert film[16] == pytest.approx(1.0)


def test_the_pocket_under_the_tip_answers_late_and_never_twice_alike() -> None:
    rows, reach = 400, np.repeat([1.1, 0.8], 200)
    pressed = np.tile(np.r_[np.ones(50), np.full(150, 0.8)], 2)
    film = np.broadcast_to(pressed[:, None], (rows, 19)).copy()
    found = pocketed(film, reach)
    body = np.delete(found, range(6, 10), axis=1)
    np.testing.assert_array_equal(body, np.delete(film, range(6, 10), axis=1))
    first, second = found[:200, 6:10], found[200:, 6:10]
    assert (np.diff(first[50:], axis=0) < 0).all()
    assert (first[50] - first[199] > 0.3 * (1.0 - first[199])).all()
    assert (np.abs(first[199] - second[199]) > 0.005).all()
    assert found.min() >= THINNEST

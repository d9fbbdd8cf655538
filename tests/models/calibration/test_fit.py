"""Placing contacts on the skin: exact where they are, honest where they cannot tell."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from taxel.errors import RecordingError, SettingsError
from taxel.skin import height_above_skin
from taxel_models.calibration.fit import Fit, fit
from taxel_models.calibration.light_contacts import LightContacts
from taxel_models.calibration.motion import Motion, Placement, outward

RADIUS = 7.0
Make = Callable[..., LightContacts]


def misaligned(contacts: LightContacts, motion: Motion) -> LightContacts:
    """The contacts in a frame from which `motion` leads back."""
    return replace(contacts, course=motion.inverse().apply(contacts.course))


def placed(found: Fit, contacts: LightContacts) -> np.ndarray:
    return found.placement.placed(contacts.position, contacts.orientation)


@settings(max_examples=3, deadline=None)
@given(
    direction=st.floats(0, 6.28),
    degrees=st.floats(0, 60),
    shift=st.tuples(*[st.floats(-50, 50)] * 3),
    standoff=st.floats(-1, 3),
)
def test_any_tilt_and_shift_are_undone_exactly(
    make_contacts: Make, direction: float, degrees: float, shift: tuple[float, ...], standoff: float
) -> None:
    true = make_contacts(standoff=standoff)
    axis = np.array([0.0, np.cos(direction), np.sin(direction)])
    recorded = misaligned(true, Motion(Rotation.from_rotvec(np.radians(degrees) * axis), np.array(shift)))
    found = fit(recorded, RADIUS, 0)
    assert not found.held
    np.testing.assert_allclose(placed(found, recorded), true.position, atol=0.03)
    assert found.placement.standoff == pytest.approx(standoff, abs=0.03)
    assert np.abs(found.after).max() < 0.03


@settings(deadline=None)
@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6), st.booleans())
def test_derivatives_are_those_of_the_distances(
    make_contacts: Make, values: list[float], oriented: bool
) -> None:
    contacts = make_contacts(12, noise=0.3)
    turns = Rotation.random(12, random_state=1).as_quat() if oriented else None
    chosen = np.array([*values, 0.4, -0.7] if oriented else values)

    def heights(components: np.ndarray) -> np.ndarray:
        placement = Placement(components, contacts.position.mean(axis=0))
        return height_above_skin(placement.placed(contacts.position, turns), RADIUS) - placement.standoff

    placement = Placement(chosen, contacts.position.mean(axis=0))
    normal = outward(placement.placed(contacts.position, turns))
    found = placement.height_derivatives(contacts.position, turns, normal)
    steps = 1e-6 * np.eye(len(chosen))
    slow = np.stack([(heights(chosen + step) - heights(chosen - step)) / 2e-6 for step in steps], axis=1)
    np.testing.assert_allclose(found, slow, atol=1e-4)


def test_a_roll_is_invisible_and_left_out(make_contacts: Make) -> None:
    true = make_contacts()
    turned = Rotation.from_euler("xyz", [40, 8, -6], degrees=True)
    recorded = misaligned(true, Motion(turned, np.array([3.0, -2.0, 4.0])))
    found = fit(recorded, RADIUS, 0)
    back = placed(found, recorded)
    assert found.placement.motion.rotation.as_rotvec()[0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(back[:, 0], true.position[:, 0], atol=0.01)
    np.testing.assert_allclose(
        np.hypot(back[:, 1], back[:, 2]), np.hypot(*true.position[:, 1:].T), atol=0.01
    )
    angles = [np.arctan2(points[:, 1], points[:, 2]) for points in (back, true.position)]
    turns = np.angle(np.exp(1j * (angles[0] - angles[1])))
    assert np.ptp(turns) < 0.01
    assert abs(turns.mean()) > 0.3


def test_contacts_on_the_cylinder_alone_do_not_tell_x(make_contacts: Make) -> None:
    true = make_contacts(200, along=(-14.0, -6.0), noise=0.1)
    recorded = misaligned(true, Motion(Rotation.from_rotvec([0, 0.1, 0.05]), np.array([2.0, 1.0, 3.0])))
    found = fit(recorded, RADIUS, 0)
    assert found.held == ("x",)
    assert found.placement.values[0] == 0.0
    assert not found.resampled[:, 0].any()
    assert (
        np.abs(height_above_skin(placed(found, recorded), RADIUS) - found.placement.standoff).mean() < 0.12
    )


def test_a_line_of_contacts_does_not_tell_the_standoff_from_a_shift(make_contacts: Make) -> None:
    found = fit(make_contacts(100, along=(-14.0, -6.0), around=0.02, noise=0.05), RADIUS, 0)
    assert {"x", "standoff"} <= set(found.held)
    assert not {"z", "tilt_y"} & set(found.held)


def test_contacts_in_one_place_are_refused(make_contacts: Make) -> None:
    contacts = make_contacts(40, along=(-5.0, -4.0), around=0.1)
    with pytest.raises(RecordingError, match=r"40 light contacts lie within 0\.\d+ mm .* of one place"):
        fit(contacts, RADIUS, 0)


def test_scattered_points_that_fit_no_skin_are_refused() -> None:
    points = np.random.default_rng(0).normal(0.0, 400.0, (20, 3))
    with pytest.raises(RecordingError, match="determine nothing"):
        fit(LightContacts(points, np.zeros(20), np.arange(20), points), RADIUS, 0)


def test_outliers_hardly_pull(make_contacts: Make) -> None:
    clean = make_contacts(200, noise=0.2)
    position = clean.position.copy()
    position[:8] += np.random.default_rng(1).normal(0.0, 15.0, (8, 3))
    with_outliers = fit(replace(clean, course=position), RADIUS, 0).placement
    without = fit(clean, RADIUS, 0).placement
    drift = with_outliers.motion.apply(clean.position) - without.motion.apply(clean.position)
    assert np.linalg.norm(drift, axis=1).max() < 0.25


def test_intervals_hold_the_truth(make_contacts: Make) -> None:
    found = fit(make_contacts(400, standoff=1.0, noise=0.5), RADIUS, 0)
    errors = found.resampled.std(axis=0)
    true = np.array([0, 0, 0, 0, 0, 1.0])
    assert (np.abs(found.placement.values - true) < 4 * errors).all()
    assert (errors[:3] < 0.2).all()
    assert (errors[:3] > 0.02).all()


def test_the_seed_says_everything(make_contacts: Make) -> None:
    contacts = make_contacts(noise=0.5)
    first, again = fit(contacts, RADIUS, 1), fit(contacts, RADIUS, 1)
    np.testing.assert_array_equal(first.placement.values, again.placement.values)
    np.testing.assert_array_equal(first.resampled, again.resampled)


def test_with_the_probes_orientation_its_offset_is_found(make_contacts: Make) -> None:
    true = make_contacts(80)
    offset = np.array([1.0, -2.0, 12.0])
    turns = Rotation.random(80, random_state=3)
    motion = Motion(Rotation.from_rotvec([0, 0.1, -0.1]), np.array([4.0, 1.0, 2.0]))
    contact = motion.inverse().apply(true.position)
    recorded = replace(true, course=contact - turns.apply(offset), course_orientation=turns.as_quat())
    found = fit(recorded, RADIUS, 0)
    np.testing.assert_allclose(found.placement.offset, offset, atol=0.01)
    np.testing.assert_allclose(placed(found, recorded), true.position, atol=0.01)
    with pytest.raises(SettingsError, match="expected no standoff"):
        fit(recorded, RADIUS, 0, standoff=2.0)


def test_a_standoff_that_is_known_is_kept(make_contacts: Make) -> None:
    found = fit(make_contacts(standoff=2.0, noise=0.1), RADIUS, 0, standoff=2.0)
    assert found.given == ("standoff",)
    assert found.placement.standoff == 2.0
    assert np.abs(found.after).mean() < 0.15

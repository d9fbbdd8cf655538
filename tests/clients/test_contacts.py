"""A simulator's contacts become the sample that models take."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from taxel.contacts import PATCH_M, ContactSample, fingertip_contacts
from taxel.errors import InputWarning, InvalidArgument
from taxel.skin import PAD, Fingertip, gap_to_skin, height_above_skin

SKIN = Fingertip.biotac_2p()
ORIGIN, UPRIGHT = np.zeros(3), np.eye(3)

pytestmark = pytest.mark.filterwarnings("ignore::taxel.errors.InputWarning")
"""Random contacts lie off the skin, too."""


def contacts(points: object, forces: object, **others: object) -> ContactSample:
    return fingertip_contacts(points, forces, ORIGIN, UPRIGHT, **others)  # type: ignore[arg-type]


@given(seed=st.integers(0, 2**31))
def test_the_frame_is_the_sensors(seed: int) -> None:
    random = np.random.default_rng(seed)
    turned = Rotation.random(random_state=seed % 2**31).as_matrix()
    away = random.normal(size=3)
    points = random.normal([-0.005, 0, -0.007], 0.002, (4, 3))
    forces = random.normal(size=(4, 3))
    here = contacts(points, forces)
    there = fingertip_contacts(points @ turned.T + away, forces @ turned.T, away, turned)
    np.testing.assert_allclose(there.position, here.position, atol=1e-12)
    np.testing.assert_allclose(there.force, here.force, atol=1e-12)
    np.testing.assert_allclose(SKIN.height(here.position), 0.0, atol=1e-15)


@given(seed=st.integers(0, 2**31), fingers=st.integers(1, 5))
def test_fingers_do_not_see_each_other(seed: int, fingers: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(0, 20))
    points, forces = random.normal(scale=0.01, size=(count, 3)), random.normal(size=(count, 3))
    on = random.integers(0, fingers, count)
    origins = random.normal(size=(fingers, 3))
    turned = Rotation.random(fingers, random_state=seed % 2**31).as_matrix()
    together = fingertip_contacts(points, forces, origins, turned, finger=on)
    for one in range(fingers):
        alone = fingertip_contacts(points[on == one], forces[on == one], origins[one], turned[one])
        for name in ("position", "force", "touched", "height", "left_out"):
            np.testing.assert_allclose(getattr(together, name)[one], getattr(alone, name)[0], atol=1e-12)


def test_one_patch_is_one_contact() -> None:
    points = [[-0.01, 0.001, -0.007], [-0.01, -0.001, -0.007]]
    sample = contacts(points, [[0, 0, 3.0], [0, 0, 1.0]])
    np.testing.assert_allclose(sample.force, [[0, 0, 4.0]])
    mean = np.array([-0.01, 0.0005, -0.007])
    np.testing.assert_allclose(sample.position[0, 0], -0.01)
    np.testing.assert_allclose(
        sample.position[0, 1:], 0.007 * mean[1:] / np.linalg.norm(mean[1:]), rtol=1e-12
    )


def test_two_contacts_far_apart_are_not_one_in_the_middle() -> None:
    points = [[0.0, 0, -0.007], [-0.02, 0, -0.007], [-0.021, 0, -0.007]]
    assert np.linalg.norm(np.subtract(points[0], points[1])) > PATCH_M
    sample = contacts(points, [[0, 0, 1.5], [0, 0, 1.0], [0, 0, 1.0]])
    np.testing.assert_allclose(sample.position, [[-0.0205, 0, -0.007]], atol=1e-15)
    np.testing.assert_allclose(sample.force, [[0, 0, 2.0]])
    np.testing.assert_allclose(sample.left_out, [1.5])


def test_nothing_touches() -> None:
    sample = contacts([], [])
    np.testing.assert_array_equal(sample.position, [PAD])
    np.testing.assert_array_equal(sample.force, np.zeros((1, 3)))
    assert not sample.touched.any()
    last = np.array([[-0.01, 0, -0.007]])
    np.testing.assert_array_equal(contacts([[1, 1, 1]], [[0, 0, 0]], last=last).position, last)


def test_no_fingertips_have_no_contacts() -> None:
    sample = fingertip_contacts([], [], np.zeros((0, 3)), np.zeros((0, 3, 3)))
    assert sample.position.shape == sample.force.shape == (0, 3)
    assert sample.touched.shape == sample.height.shape == sample.left_out.shape == (0,)


def test_a_wrong_unit_shows_in_the_height() -> None:
    assert contacts([[-10.0, 0, -7.0]], [[0, 0, 1.0]]).height[0] > 1.0


def test_the_skin_lies_over_the_electrodes() -> None:
    assert (SKIN.height(SKIN.electrodes) < 0).all()
    over = gap_to_skin(SKIN.electrodes, SKIN.normals, SKIN.radius)
    points = SKIN.electrodes + over[:, None] * SKIN.normals
    np.testing.assert_allclose(height_above_skin(points, SKIN.radius), 0.0, atol=1e-12)
    # No other place of the skin is nearer than the one that `nearest` gives.
    nearest = np.linalg.norm(SKIN.nearest(SKIN.electrodes) - SKIN.electrodes, axis=1)
    np.testing.assert_allclose(nearest, -SKIN.height(SKIN.electrodes), atol=1e-12)


@pytest.mark.parametrize(
    ("points", "forces", "others", "said"),
    [
        ([[0, 0, 0]], [], {}, "1 points and 0 forces"),
        ([[0, 0]], [[0, 0]], {}, r"points has shape \(1, 2\): expected \(k, 3\)"),
        (None, [[0, 0, 1]], {}, r"points has shape \(\): expected \(k, 3\)"),
        ("here", [[0, 0, 1]], {}, "points: could not convert string to float"),
        ([[0, 0, 0]], torch.zeros(1, 3, requires_grad=True), {}, "forces: .*detach"),
        ([[0, 0, np.inf]], [[0, 0, 1]], {}, r"points\[0\] is \[0.0, 0.0, inf\]: expected finite"),
        ([[0, 0, 0]], [[0, 0, 1]], {"finger": [1]}, "finger is 1 to 1: expected 0 to 0"),
        ([[0, 0, 0]], [[0, 0, 1]], {"last": np.zeros((2, 3))}, "last has 2 places"),
    ],
)
def test_a_wrong_argument_is_named(points: object, forces: object, others: object, said: str) -> None:
    with pytest.raises(InvalidArgument, match=said):
        contacts(points, forces, **others)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="expected a rotation matrix"):
        fingertip_contacts([], [], ORIGIN, 2 * UPRIGHT)


@pytest.mark.parametrize(
    ("point", "text"),
    [
        ([0.0, 0.0, -7.0], "more than 4 mm off the skin: they look like millimetres, expected metres"),
        ([0.0, 0.0, -0.001], "more than 4 mm off the skin: expected points of the fingertip"),
    ],
)
def test_contacts_off_the_skin_are_told(point: list[float], text: str) -> None:
    with pytest.warns(InputWarning, match=text):
        contacts([point], [[0.0, 0.0, 1.0]])
    with pytest.raises(InvalidArgument, match=text):
        contacts([point], [[0.0, 0.0, 1.0]], strict=True)


@pytest.mark.filterwarnings("error")
def test_contacts_near_the_skin_and_none_are_right() -> None:
    near = contacts([[0.0, 0.0, -0.0065], [-0.004, 0.0, -0.0075]], [[0.0, 0.0, 1.0]] * 2, strict=True)
    np.testing.assert_allclose(near.force, [[0.0, 0.0, 2.0]])
    assert not contacts(np.empty((0, 3)), np.empty((0, 3)), strict=True).touched.any()

"""The unrolled skin against the skin itself."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from taxel.skin import Fingertip, patch
from taxel_watch.skin_map import MM, coordinates, electrodes_on_map, flat, force_on_map, on_map, outline

TIP = Fingertip.biotac_2p()
ALONG = st.floats(-0.016, 0.99 * TIP.radius * np.pi / 2)
AROUND = st.floats(-1.8, 1.8)
NEWTONS = st.floats(-10, 10)


@given(ALONG, AROUND)
def test_coordinates_are_those_that_the_place_was_made_from(along: float, around: float) -> None:
    place = patch(np.array([along]), np.array([around]), TIP.radius).point
    found = coordinates(place, TIP.radius)
    np.testing.assert_allclose([found[0][0], found[1][0]], [along, around], atol=1e-6)


@given(ALONG, AROUND)
def test_small_areas_keep_their_size(along: float, around: float) -> None:
    step = 1e-5
    if abs(along) < 2 * step:
        return
    corners = [(0.0, 0.0), (step, 0.0), (0.0, step / TIP.radius)]
    skin = [patch(np.array([along + a]), np.array([around + b]), TIP.radius).point[0] for a, b in corners]
    area = np.linalg.norm(np.cross(skin[1] - skin[0], skin[2] - skin[0]))
    map_ = [flat(np.array([along + a]), np.array([around + b]), TIP.radius)[0] / MM for a, b in corners]
    (ax, ay), (bx, by) = map_[1] - map_[0], map_[2] - map_[0]
    np.testing.assert_allclose(abs(ax * by - ay * bx), area, rtol=1e-2, atol=1e-14)


def test_the_map_has_the_sides_of_the_finger() -> None:
    electrodes = electrodes_on_map(TIP)
    assert electrodes.shape == (19, 2)
    # e2 and e12 mirror each other; e7 is next to the tip, e19 furthest from it.
    np.testing.assert_allclose(electrodes[1], electrodes[11] * [-1, 1], atol=1e-9)
    assert electrodes[:, 1].argmax() == 6
    assert electrodes[:, 1].argmin() == 18
    np.testing.assert_allclose(on_map(np.array([[0.0, 0.0, -0.007]]), TIP), [[0.0, 0.0]], atol=1e-9)


def test_the_edge_encloses_every_electrode() -> None:
    from matplotlib.path import Path

    assert Path(outline(TIP)).contains_points(electrodes_on_map(TIP)).all()


@given(ALONG, AROUND, NEWTONS, NEWTONS, NEWTONS)
def test_a_force_is_what_its_three_parts_say(
    along: float, around: float, press: float, across: float, forward: float
) -> None:
    place = patch(np.array([along]), np.array([around]), TIP.radius)
    force = -press * place.normal + across * place.sideways + forward * place.forward
    parts = force_on_map(place.point, force, TIP)
    np.testing.assert_allclose(parts, [[press, across, forward]], atol=1e-6)


def test_a_press_on_the_pad_goes_into_the_skin() -> None:
    parts = force_on_map(np.array([[-0.006, 0.0, -0.007]]), np.array([[0.5, 0.25, 2.0]]), TIP)
    np.testing.assert_allclose(parts, [[2.0, 0.25, 0.5]], atol=1e-9)

"""Adapters take tensors of the shapes that their simulators document. No simulator runs here."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import taxel.adapters
from taxel.adapters import isaac_lab, maniskill, mjlab
from taxel.adapters.frames import Mount, rotations
from taxel.contacts import ContactSample, fingertip_contacts
from taxel.errors import InputWarning, InvalidArgument
from taxel.skin import PAD, Fingertip

ENVIRONMENTS, TIPS = 3, 2
COUNT = ENVIRONMENTS * TIPS
Array = NDArray[np.float64]


def poses(seed: int) -> tuple[Array, Rotation]:
    random = np.random.default_rng(seed)
    return random.normal(size=(COUNT, 3)), Rotation.random(COUNT, random_state=seed)


def touches(seed: int, each: int) -> tuple[Array, Array, Array, Rotation]:
    """Points and forces on the finger, (COUNT, each, 3), in the world, and the poses of the sensors."""
    random = np.random.default_rng(seed)
    origins, turned = poses(seed)
    # Near each other, so that they are one patch.
    places = random.normal([-0.004, 0.0, -0.007], 0.0005, (COUNT, each, 3))
    pushes = random.normal([0.0, 0.0, 1.0], 0.2, (COUNT, each, 3))
    matrices = turned.as_matrix()
    points = origins[:, None] + np.einsum("nij,nkj->nki", matrices, places)
    return points, np.einsum("nij,nkj->nki", matrices, pushes), origins, turned


def tensor(values: Array, *shape: int) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float32).reshape(shape)


def check(found: ContactSample, expected: ContactSample) -> None:
    """As near as float32 in the world lets it be."""
    np.testing.assert_allclose(found.position, expected.position, atol=1e-6)
    np.testing.assert_allclose(found.force, expected.force, atol=1e-6)
    np.testing.assert_array_equal(found.touched, expected.touched)


ISAAC_LAB = {
    "pos_w": np.zeros((1, 2, 3)),
    "quat_w": np.tile([0.0, 0.0, 0.0, 1.0], (1, 2, 1)),
    "force_matrix_w": np.zeros((1, 2, 4, 3)),
    "contact_pos_w": np.zeros((1, 2, 4, 3)),
}
MJLAB = {"found": np.ones((1, 2)), "force": np.zeros((1, 2, 3)), "pos": np.zeros((1, 2, 3))}


@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("pos_w", None, r"pos_w is None: expected a tensor \(n, n, 3\), with track_pose=True"),
        ("force_matrix_w", None, "force_matrix_w is None: .*filter_prim_paths_expr"),
        ("contact_pos_w", None, "contact_pos_w is None: .*track_contact_points=True"),
        ("contact_pos_w", np.zeros((1, 2, 3)), r"shape \(1, 2, 3\): expected \(1, 2, 4, 3\)"),
        ("quat_w", np.zeros((1, 2, 4)), "is no rotation: expected unit quaternions"),
    ],
)
def test_what_isaac_lab_does_not_give_is_told(name: str, values: Any, text: str) -> None:
    with pytest.raises(InvalidArgument, match=text):
        isaac_lab.contact_sample(SimpleNamespace(**{**ISAAC_LAB, name: values}))


@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("found", None, r"found is None: expected a tensor \(1, n\), with fields="),
        ("found", np.ones((1, 3)), "as many slots for each of 2 primaries"),
        ("pos", np.zeros((2, 3)), r"pos has shape \(2, 3\): expected \(1, 2, 3\)"),
    ],
)
def test_what_mjlab_does_not_give_is_told(name: str, values: Any, text: str) -> None:
    poses = np.zeros((1, 2, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (1, 2, 1))
    with pytest.raises(InvalidArgument, match=text):
        mjlab.contact_sample(SimpleNamespace(**{**MJLAB, name: values}), *poses)


def test_quaternions_are_rotations() -> None:
    turned = Rotation.random(20, random_state=3)
    np.testing.assert_allclose(rotations(turned.as_quat(scalar_first=True)), turned.as_matrix(), atol=1e-12)


def test_isaac_lab() -> None:
    filters = 4
    points, forces, origins, turned = touches(1, filters)
    mount = Mount(np.array([0.01, 0.0, -0.002]), Rotation.from_euler("y", 30, degrees=True).as_matrix())
    # The body on which the sensor is mounted so.
    body = turned.as_matrix() @ mount.rotation.T
    places = origins - body @ mount.position
    points[1, 2], forces[1, 2] = np.nan, 0.0
    points[4] = np.nan
    quaternion = Rotation.from_matrix(body).as_quat()
    data = SimpleNamespace(
        pos_w=SimpleNamespace(torch=tensor(places, ENVIRONMENTS, TIPS, 3)),
        quat_w=SimpleNamespace(torch=tensor(quaternion, ENVIRONMENTS, TIPS, 4)),
        force_matrix_w=SimpleNamespace(torch=tensor(forces, ENVIRONMENTS, TIPS, filters, 3)),
        contact_pos_w=SimpleNamespace(torch=tensor(points, ENVIRONMENTS, TIPS, filters, 3)),
    )
    known = np.isfinite(points).all(axis=2)
    finger = np.repeat(np.arange(COUNT), filters).reshape(COUNT, filters)[known]
    expected = fingertip_contacts(points[known], forces[known], origins, turned.as_matrix(), finger=finger)
    check(isaac_lab.contact_sample(data, mount=mount), expected)
    assert expected.touched.tolist() == [True] * 4 + [False, True]


@pytest.mark.parametrize("slots", [1, 3])
def test_mjlab(slots: int) -> None:
    points, forces, origins, turned = touches(2, slots)
    found = np.ones((COUNT, slots))
    found[2] = 0
    data = SimpleNamespace(
        found=tensor(found, ENVIRONMENTS, TIPS * slots),
        force=tensor(-forces, ENVIRONMENTS, TIPS * slots, 3),
        pos=tensor(points, ENVIRONMENTS, TIPS * slots, 3),
    )
    sites = (
        tensor(origins, ENVIRONMENTS, TIPS, 3),
        tensor(turned.as_quat(scalar_first=True), ENVIRONMENTS, TIPS, 4),
    )
    known = found.astype(bool)
    finger = np.repeat(np.arange(COUNT), slots).reshape(COUNT, slots)[known]
    expected = fingertip_contacts(points[known], forces[known], origins, turned.as_matrix(), finger=finger)
    check(mjlab.contact_sample(data, *sites), expected)


def test_maniskill() -> None:
    origins, turned = poses(3)
    own = np.tile([[0.0, 0.0, 2.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], (2, 1))
    forces = turned.apply(own)
    radius = Fingertip.biotac_2p().radius

    class Scene:
        def get_pairwise_contact_forces(self, first: Any, second: str) -> torch.Tensor:
            return tensor(forces if second == "cube" else 0.0 * forces, COUNT, 3)

    pose = SimpleNamespace(
        p=tensor(origins, COUNT, 3), q=tensor(turned.as_quat(scalar_first=True), COUNT, 4)
    )
    found = maniskill.contact_sample(Scene(), SimpleNamespace(pose=pose), ["table", "cube"])
    np.testing.assert_allclose(found.force, own, atol=1e-6)
    # Pressed from below, at the tip, and not at all.
    expected = np.tile([[0, 0, -radius], [radius, 0, 0], PAD], (2, 1))
    np.testing.assert_allclose(found.position, expected, atol=1e-6)
    assert found.touched.tolist() == [True, True, False] * 2


def far_away(adapter: str, strict: bool) -> ContactSample:
    """Contacts that are not on the skin, by each adapter."""
    points, forces, origins, turned = touches(5, 1)
    points = points + 7.0
    quaternion = turned.as_quat(scalar_first=True)
    shape = (ENVIRONMENTS, TIPS)
    if adapter == "isaac_lab":
        data = SimpleNamespace(
            pos_w=tensor(origins, *shape, 3),
            quat_w=tensor(turned.as_quat(), *shape, 4),
            force_matrix_w=tensor(forces, *shape, 1, 3),
            contact_pos_w=tensor(points, *shape, 1, 3),
        )
        return isaac_lab.contact_sample(data, strict=strict)
    if adapter == "mjlab":
        data = SimpleNamespace(
            found=tensor(np.ones(COUNT), *shape),
            force=tensor(-forces, *shape, 3),
            pos=tensor(points, *shape, 3),
        )
        return mjlab.contact_sample(
            data, tensor(origins, *shape, 3), tensor(quaternion, *shape, 4), strict=strict
        )
    # Its places are made from forces: one that pushes out of the base is on no skin.
    scene = SimpleNamespace(
        get_pairwise_contact_forces=lambda *_: tensor(turned.apply([1.0, 0.0, 0.0]), COUNT, 3)
    )
    pose = SimpleNamespace(p=tensor(origins, COUNT, 3), q=tensor(quaternion, COUNT, 4))
    return maniskill.contact_sample(scene, SimpleNamespace(pose=pose), ["cube"], strict=strict)


@pytest.mark.parametrize("adapter", ["isaac_lab", "mjlab", "maniskill"])
def test_strict_makes_an_error_of_a_warning(adapter: str) -> None:
    with pytest.warns(InputWarning, match="more than 4 mm off the skin"):
        far_away(adapter, strict=False)
    with pytest.raises(InvalidArgument, match="more than 4 mm off the skin"):
        far_away(adapter, strict=True)


def test_an_adapter_is_read_at_a_glance() -> None:
    folder = Path(taxel.adapters.__file__).parent
    for name in ("isaac_lab", "mjlab", "maniskill"):
        text = (folder / f"{name}.py").read_text(encoding="utf-8")
        assert len(text.splitlines()) <= 54
        assert "not run with" in text.splitlines()[0]

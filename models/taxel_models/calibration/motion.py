"""The estimated components: a rigid motion into the sensor's frame, and the offset of the tracked point.

The skin is a surface of revolution about x, so a rotation about x (roll) changes no distance to it. Of all
motions that differ only by a roll, the one with the smallest rotation is taken. Its rotation vector has no
x component; the two others are the tilts.

Translations are those of the contacts' centre along the sensor's axes. If the contacts do not determine a
component, it is held at 0 and leaves the recorded positions as they are.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from taxel_models.calibration.light_contacts import LightContacts

RIGID: Final = ("x", "y", "z", "tilt_y", "tilt_z")
STANDOFF: Final = ("standoff",)
OFFSET: Final = ("offset_x", "offset_y", "offset_z")

ANGLES: Final = ("tilt_y", "tilt_z")
"""Components in radians; all others are in mm."""


@dataclass(frozen=True)
class Motion:
    """From the recorded frame to the sensor's: p' = R p + t.

    Attributes:
        rotation: R, a scipy Rotation.
        translation: t, (3,), mm.
    """

    rotation: Any
    translation: NDArray[np.float64]

    def apply(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (n, 3) in mm."""
        return np.asarray(self.rotation.apply(points) + self.translation)

    def turn(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Directions or forces (n, 3): rotated, not shifted."""
        return np.asarray(self.rotation.apply(vectors))

    def inverse(self) -> "Motion":
        """From the sensor's frame to the recorded one."""
        back = self.rotation.inv()
        return Motion(back, -back.apply(self.translation))


@dataclass(frozen=True)
class Placement:
    """Values of the components, and their centre.

    Without the probe's orientation, light contacts determine only the standoff of the probe: the distance
    of the tracked point from the skin at first touch, along the skin's normal (a tracked sphere's radius).
    With the orientation, they determine the contact point's offset in the probe's frame.

    Attributes:
        values: (k,) in the order of `components_of`.
        centre: (3,), mm, of the light contacts as recorded.
    """

    values: NDArray[np.float64]
    centre: NDArray[np.float64]

    @property
    def motion(self) -> Motion:
        """The rigid motion alone."""
        tilt = Rotation.from_rotvec([0.0, *self.values[3:5]])
        return Motion(tilt, self.values[:3] + self.centre - tilt.apply(self.centre))

    @property
    def standoff(self) -> float:
        """Distance of the tracked point from the skin at first touch, mm; 0 if an offset is fitted."""
        return float(self.values[5]) if len(self.values) == len(RIGID + STANDOFF) else 0.0

    @property
    def offset(self) -> NDArray[np.float64]:
        """(3,), from tracked point to contact point in the probe's frame, mm; 0 if a standoff is fitted."""
        return self.values[5:] if len(self.values) == len(RIGID + OFFSET) else np.zeros(3)

    def placed(
        self, points: NDArray[np.float64], orientation: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Tracked points (n, 3), mm, with the probe's orientation (n, 4), in the sensor's frame."""
        if orientation is not None:
            points = points + Rotation.from_quat(orientation).apply(self.offset)
        return self.motion.apply(points)

    def height_derivatives(
        self,
        points: NDArray[np.float64],
        orientation: NDArray[np.float64] | None,
        normal: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Derivatives of the placed points' distances from the skin, minus the standoff, by each component.

        A small change dv of the rotation vector v rotates by J(v) dv, with the left Jacobian of SO(3)
        (Solà, Deray and Atchuthan 2018, A micro Lie theory for state estimation in robotics, eq. 145).

        Args:
            points: (n, 3), tracked, mm.
            orientation: (n, 4), the probe's quaternions, if recorded.
            normal: (n, 3), the skin's normals at the placed contacts.

        Returns:
            (n, k), mm by mm or rad.
        """
        motion = self.motion
        arms = points - self.centre
        if orientation is None:
            probe = np.full((len(points), 1), -1.0)
        else:
            turns = Rotation.from_quat(orientation)
            arms = arms + turns.apply(self.offset)
            probe = np.einsum("ijk,ij->ik", turns.as_matrix(), motion.rotation.inv().apply(normal))
        turning = np.cross(motion.turn(arms), normal) @ _left_jacobian(self.values[3:5])
        return np.column_stack([normal, turning[:, 1:], probe])


def outward(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors (n, 3) away from the skin's axis and, at the tip, its centre."""
    off_axis = points.copy()
    off_axis[:, 0] = np.maximum(off_axis[:, 0], 0.0)
    length = np.linalg.norm(off_axis, axis=1, keepdims=True)
    return np.asarray(off_axis / np.maximum(length, np.finfo(float).tiny))


def _left_jacobian(tilt: NDArray[np.float64]) -> NDArray[np.float64]:
    y, z = tilt
    angle = float(np.hypot(y, z))
    if angle < 1e-8:
        return np.eye(3)
    cross = np.array([[0.0, -z, y], [z, 0.0, 0.0], [-y, 0.0, 0.0]])
    first = (1.0 - np.cos(angle)) / angle**2
    second = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def components_of(contacts: LightContacts) -> tuple[str, ...]:
    """The components that are fitted to these contacts."""
    return RIGID + (STANDOFF if contacts.orientation is None else OFFSET)

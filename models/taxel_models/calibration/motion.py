"""What is estimated: a rigid motion into the sensor's frame, and how far the tracked point is off.

The skin is a surface of revolution about x, so that a turn about x (roll) changes no distance to it.
Of all motions that differ by a roll, the one that turns least is taken: its rotation vector has no x
component, and two components, the tilts, are left.

Translations are those of the contacts' centre along the sensor's axes. So a component that the
contacts do not determine can be held at 0, where it leaves the recorded positions as they are.
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
        """Directions or forces (n, 3): turned, not shifted."""
        return np.asarray(self.rotation.apply(vectors))

    def inverse(self) -> "Motion":
        """From the sensor's frame to the recorded one."""
        back = self.rotation.inv()
        return Motion(back, -back.apply(self.translation))


@dataclass(frozen=True)
class Placement:
    """Values of the components, with what they refer to.

    Without the probe's orientation, all that light contacts can tell about the probe is the standoff:
    how far off the skin the tracked point is as the probe just touches it, along the skin's normal (a
    tracked sphere's radius). With the orientation, it is the contact point's offset in the probe's frame.

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
        """Distance of the tracked point from the skin as it just touches, mm; 0 with an offset."""
        return float(self.values[5]) if len(self.values) == len(RIGID + STANDOFF) else 0.0

    @property
    def offset(self) -> NDArray[np.float64]:
        """(3,), from the tracked point to the contact point in the probe's frame, mm; 0 with a standoff."""
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
        """How the placed points' distances from the skin, less the standoff, change with each component.

        A small change of the rotation vector v turns by J(v) dv, with the left Jacobian of SO(3)
        (Solà, Deray and Atchuthan 2018, A micro Lie theory for state estimation in robotics, eq. 145).

        Args:
            points: (n, 3), tracked, mm.
            orientation: (n, 4), the probe's quaternions, if recorded.
            normal: (n, 3), of the skin where the contacts are placed.

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

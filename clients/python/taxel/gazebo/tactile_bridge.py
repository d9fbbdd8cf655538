"""The fingertips of a world in Gazebo, whatever carries its messages."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.adapters.frames import rotations
from taxel.contacts import fingertip_contacts
from taxel.errors import InvalidArgument, RequestError
from taxel.gazebo.messages import Pose, Touches, poses_of, sim_time_ns, touches_of
from taxel.gazebo.settings import BridgeSettings, GazeboFinger
from taxel.input_checks import warn
from taxel.predictor import Predictor
from taxel.skin import PAD, Fingertip


class Prediction(NamedTuple):
    """The channels of all fingers after a step of the world.

    Attributes:
        stamp_ns: the simulated time of the step.
        channels: (n, 21) float32, counts, in the order of the settings' fingers.
    """

    stamp_ns: int
    channels: NDArray[np.float32]


class TactileBridge:
    """Takes messages of Gazebo and gives channels. It knows no transport.

    A world publishes its clock first in each step, and then contacts, of sensors that touch something, and
    poses. So when the clock has gone on, the step before is complete: whatever brought no contacts in it,
    nothing touches.

    Args:
        predictor: predicts the channels.
        settings: the fingers.

    Attributes:
        refused: how many messages could not be used; each reason is told once, as an `InputWarning`.
    """

    def __init__(self, predictor: Predictor, settings: BridgeSettings) -> None:
        self._settings = settings
        self._fingers = predictor.fingers(len(settings.fingers), rate_hz=settings.rate_hz)
        self._poses: dict[str, Pose | None] = {}
        self._begin(None)
        self.refused = 0

    def _begin(self, now_ns: int | None) -> None:
        self._now_ns, self._sampled_ns = now_ns, now_ns
        self._touches: dict[int, Touches] = {}
        self._places = np.tile(np.array(PAD), (len(self._settings.fingers), 1))
        self._fingers.reset()

    def take_poses(self, message: Any) -> None:
        """Take a `Pose_V`: the poses of models in the world or in their models, and of links in models.

        Raises:
            InvalidArgument: a pose is none.
        """
        self._poses.update(poses_of(message))

    def take_contacts(self, finger: int, message: Any) -> None:
        """Take the `Contacts` of a finger's sensor; `finger` is its number in the settings.

        Raises:
            InvalidArgument: forces are missing, or a number is not finite.
        """
        self._touches[finger] = touches_of(message)

    def take_clock(self, message: Any) -> Prediction | None:
        """Take a `Clock`, and step the fingers if the world has; gives their channels if they are new.

        A world that began again, or went back, begins the fingers again. In a paused one nothing happens.
        """
        now_ns, ended_ns = sim_time_ns(message), self._now_ns
        if ended_ns is None or self._sampled_ns is None or now_ns < ended_ns:
            self._begin(now_ns)
            return None
        if now_ns == ended_ns:
            return None
        position, force = self._sample()
        # The first sample of all has none before it.
        dt = (ended_ns - self._sampled_ns) / 1e9 or None
        self._now_ns, self._sampled_ns = now_ns, ended_ns
        before = self._fingers.channels
        try:
            channels = self._fingers.step(position, force, dt)
        except RequestError as error:
            self.refuse(f"no prediction: {error}")
            return None
        return None if channels is before else Prediction(ended_ns, channels)

    def refuse(self, reason: str) -> None:
        """Count a message that cannot be used, and warn of it."""
        self.refused += 1
        warn(reason)

    def _sample(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places and forces (n, 3) of the step that has ended, in the sensors' frames."""
        count = len(self._settings.fingers)
        rows: list[NDArray[np.float64]] = []
        fingers: list[int] = []
        for number, touches in self._touches.items():
            try:
                origin, turned = self._frame(self._settings.fingers[number])
            except InvalidArgument as error:
                self.refuse(str(error))
                continue
            points = (touches.points - origin) @ turned
            forces = on_finger(points, touches.forces @ turned, touches.normals @ turned)
            rows.append(np.hstack([points, forces]))
            fingers += [number] * len(points)
        self._touches = {}
        if not fingers:
            return self._places, np.zeros((count, 3))
        table = np.vstack(rows)
        here = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
        sample = fingertip_contacts(
            table[:, :3], table[:, 3:], *here, finger=np.array(fingers), last=self._places
        )
        self._places = sample.position
        return sample.position, sample.force

    def _frame(self, finger: GazeboFinger) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The origin (3,) and the axes (3, 3) of a finger's sensor, world frame."""
        origin, turned = np.zeros(3), np.eye(3)
        for depth in range(1, len(finger.link) + 1):
            pose = self._pose(finger, "::".join(finger.link[:depth]), finger.link[depth - 1])
            origin = origin + turned @ pose.position
            turned = turned @ rotations(pose.quaternion[None])[0]
        mount = self._settings.mount
        return origin + turned @ mount.position, turned @ mount.rotation

    def _pose(self, finger: GazeboFinger, scoped: str, name: str) -> Pose:
        # Gazebo's pose publisher tells names with their models', its scene broadcaster without.
        found = scoped if scoped in self._poses else name
        pose, topic = self._poses.get(found), self._settings.pose_topic
        if pose is not None:
            return pose
        if found in self._poses:
            raise InvalidArgument(
                f"{finger.name}: {topic} has two poses of {found!r}: expected names that differ, or the "
                "topic of a pose publisher of one model"
            )
        raise InvalidArgument(f"{finger.name}: {topic} has no pose of {scoped!r}")


def on_finger(
    points: NDArray[np.float64], forces: NDArray[np.float64], normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The forces on the finger, of forces on one of two bodies.

    Gazebo tells the force on the physics engine's first body, but not which of the two that is. A contact
    only pushes: of a force and its opposite, the one is taken that points along the contact's normal into
    the finger.

    Args:
        points: (k, 3), where the contacts are, m, sensor's frame.
        forces: (k, 3), N, sensor's frame.
        normals: (k, 3), along the contacts' normals, either way; where zero, the force's own line counts.
    """
    along = np.where(normals.any(axis=1, keepdims=True), normals, forces)
    outward = np.einsum("ij,ij->i", along, Fingertip.biotac_2p().normal(points))
    pulls = np.einsum("ij,ij->i", along, forces) * outward > 0.0
    return np.where(pulls[:, None], -forces, forces)

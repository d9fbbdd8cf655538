"""The fingertips of a world in Gazebo, whatever carries its messages."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.adapters.frames import rotations
from taxel.contacts import fingertip_contacts
from taxel.errors import InvalidArgument, RequestError
from taxel.gazebo.messages import CLOCK, CONTACTS, POSES, Pose, decode, poses_of, sim_time_ns, touches_of
from taxel.gazebo.settings import BridgeSettings
from taxel.input_checks import warn
from taxel.predictor import Predictor
from taxel.skin import PAD, Fingertip
from taxel.windows.samples import SampledSteps

_POSES_WITHIN_NS: Final = 1_000_000_000
"""So much simulated time may pass until the first poses; contacts before them are not used."""


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

    Windows take samples every 10 ms. Where these fall on steps of the world, the messages of the steps
    between change no window, and are not read.

    Args:
        predictor: predicts the channels.
        settings: the fingers.

    Attributes:
        refused: how many messages could not be used; each reason is told once, as an `InputWarning`.

    Raises:
        InvalidArgument: the settings are strict, and the world steps too slowly for the model. What takes a
            message raises it, too, where it would warn of an input.
    """

    def __init__(self, predictor: Predictor, settings: BridgeSettings) -> None:
        self._settings = settings
        self._sampled = SampledSteps.of(settings.rate_hz)
        self._fingers = predictor.fingers(
            len(settings.fingers), rate_hz=settings.rate_hz, strict=settings.strict
        )
        self._links = [_scopes(finger.link) for finger in settings.fingers]
        self._names = {name for link in self._links for scope in link for name in scope}
        self._pose_payload: bytes | None = None
        self._poses: dict[str, Pose | None] = {}
        self._posed = False
        self._begin(None)
        self.refused = 0

    def _begin(self, now_ns: int | None) -> None:
        """Begin the fingers again, as if nothing had touched them for long."""
        self._now_ns = now_ns
        self._begun_ns = now_ns or 0
        self._sampled_ns: int | None = None
        self._contacts: dict[int, bytes] = {}
        self._places = np.tile(np.array(PAD), (len(self._settings.fingers), 1))
        self._fingers.reset()

    def take_poses(self, payload: bytes) -> None:
        """Take a `Pose_V`: the poses of models in the world or in their models, and of links in models."""
        self._pose_payload, self._posed = payload, True

    def take_contacts(self, finger: int, payload: bytes) -> None:
        """Take the `Contacts` of a finger's sensor; `finger` is its number in the settings."""
        self._contacts[finger] = payload

    def take_clock(self, payload: bytes) -> Prediction | None:
        """Take a `Clock`, and step the fingers if the world has; gives their channels if they are new.

        A world that began again, or went back, begins the fingers again. In a paused one nothing happens.
        """
        try:
            now_ns = sim_time_ns(decode(payload, CLOCK))
        except InvalidArgument as error:
            self.refuse(f"{self._settings.clock}: {error}")
            return None
        ended_ns = self._now_ns
        if ended_ns is None or now_ns < ended_ns:
            self._begin(now_ns)
            return None
        if now_ns == ended_ns:
            return None
        self._now_ns = now_ns
        contacts, self._contacts = self._contacts, {}
        if contacts and not self._posed and ended_ns - self._begun_ns < _POSES_WITHIN_NS:
            # A bridge that comes to a running world hears contacts before poses.
            self._sampled_ns = None
            return None
        elapsed_ns = self._sampled.first_ns if self._sampled_ns is None else ended_ns - self._sampled_ns
        if elapsed_ns <= self._sampled.least_ns:
            return None
        self._sampled_ns = ended_ns
        return self._step(contacts, ended_ns, elapsed_ns)

    def _step(self, contacts: dict[int, bytes], ended_ns: int, elapsed_ns: int) -> Prediction | None:
        position, force = self._sample(contacts)
        before = self._fingers.channels
        try:
            channels = self._fingers.step(position, force, elapsed_ns / 1e9)
        except RequestError as error:
            # Where a server does not answer there are no channels, which is nothing to be strict about.
            if self._settings.strict and isinstance(error, InvalidArgument):
                raise
            self.refused += 1
            warn(f"no prediction: {error}")
            return None
        return None if self._fingers.channels is before else Prediction(ended_ns, channels)

    def refuse(self, reason: str) -> None:
        """Count a message that cannot be used, and warn of it; or raise, if the settings are strict."""
        self.refused += 1
        self.tell(reason)

    def tell(self, text: str) -> None:
        """Warn of an input; or raise, if the settings are strict."""
        if self._settings.strict:
            raise InvalidArgument(text)
        warn(text)

    def _sample(self, contacts: dict[int, bytes]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places and forces (n, 3) of the step that has ended, in the sensors' frames."""
        count = len(self._settings.fingers)
        rows: list[NDArray[np.float64]] = []
        fingers: list[int] = []
        if contacts:
            self._read_poses()
        for number, payload in contacts.items():
            finger = self._settings.fingers[number]
            try:
                touches = touches_of(decode(payload, CONTACTS))
                origin, turned = self._frame(number)
            except InvalidArgument as error:
                self.refuse(f"{finger.contacts}: {error}")
                continue
            points = (touches.points - origin) @ turned
            forces = on_finger(points, touches.forces @ turned, touches.normals @ turned)
            rows.append(np.hstack([points, forces]))
            fingers += [number] * len(points)
        if not fingers:
            return self._places, np.zeros((count, 3))
        table = np.vstack(rows)
        here = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
        sample = fingertip_contacts(
            table[:, :3],
            table[:, 3:],
            *here,
            finger=np.array(fingers),
            last=self._places,
            strict=self._settings.strict,
        )
        self._places = sample.position
        return sample.position, sample.force

    def _read_poses(self) -> None:
        """Read the newest poses; those before stay if they are none."""
        payload, self._pose_payload = self._pose_payload, None
        if payload is None:
            return
        try:
            self._poses = poses_of(decode(payload, POSES), self._names)
        except InvalidArgument as error:
            self.refuse(f"{self._settings.pose_topic}: {error}")

    def _frame(self, number: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The origin (3,) and the axes (3, 3) of a finger's sensor, world frame."""
        origin, turned = np.zeros(3), np.eye(3)
        for scope in self._links[number]:
            pose = self._pose(scope)
            origin = origin + turned @ pose.position
            turned = turned @ rotations(pose.quaternion[None])[0]
        mount = self._settings.mount
        return origin + turned @ mount.position, turned @ mount.rotation

    def _pose(self, scope: tuple[str, str]) -> Pose:
        # Gazebo's pose publisher tells names with their models', its scene broadcaster without.
        scoped, name = scope
        found = scoped if scoped in self._poses else name
        pose, topic = self._poses.get(found), self._settings.pose_topic
        if pose is not None:
            return pose
        if found in self._poses:
            raise InvalidArgument(
                f"{topic} has two poses of {found!r}: expected names that differ, or the topic of a pose "
                "publisher of one model"
            )
        raise InvalidArgument(f"{topic} has no pose of {scoped!r}")


def _scopes(link: tuple[str, ...]) -> list[tuple[str, str]]:
    """The name of each model and of the link: with their models', and without."""
    return [("::".join(link[:depth]), link[depth - 1]) for depth in range(1, len(link) + 1)]


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

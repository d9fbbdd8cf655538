"""What a user says of the fingertips of a world in Gazebo."""

import re
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from taxel.adapters.frames import ON_THE_BODY, Mount, rotations
from taxel.arguments import is_real
from taxel.errors import SettingsError
from taxel.gazebo.gz_transport import checked_name

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_EXPECTED: Final = (
    "expected NAME=MODEL/LINK/SENSOR, such as ff=hand/ff_distal/touch, or NAME=MODEL/LINK:TOPIC"
)


@dataclass(frozen=True)
class GazeboFinger:
    """A fingertip: a link, and a contact sensor on it.

    Attributes:
        name: the first part of the topic of its channels.
        link: names from the outermost model to the link.
        contacts: the topic of its contact sensor.
    """

    name: str
    link: tuple[str, ...]
    contacts: str

    @classmethod
    def parsed(cls, text: str, world: str) -> Self:
        """From NAME=MODEL/LINK/SENSOR, or NAME=MODEL/LINK:TOPIC where the sensor has a topic of its own.

        Raises:
            SettingsError: it is neither, or no world can be called so.
        """
        checked_name("world", f"/world/{world}")
        name, _, rest = text.partition("=")
        path, _, topic = rest.partition(":")
        parts = tuple(path.split("/"))
        link = parts if topic else parts[:-1]
        if not _NAME.fullmatch(name) or len(link) < 2 or not all(parts):
            raise SettingsError(f"finger {text!r}: {_EXPECTED}")
        models = "".join(f"/model/{model}" for model in link[:-1])
        topic = topic or f"/world/{world}{models}/link/{link[-1]}/sensor/{parts[-1]}/contact"
        return cls(name, link, checked_name(f"finger {text!r}: topic", "/" + topic.removeprefix("/")))

    @property
    def channels(self) -> str:
        """The topic of its channels."""
        return f"/{self.name}/tactile"


@dataclass(frozen=True)
class BridgeSettings:
    """The fingertips of a world.

    Attributes:
        world: its name.
        fingers: its fingertips.
        poses: the topic that brings poses; the world's own if None.
        mount: the sensor's frame (`taxel.skin`) in the links'.
        rate_hz: how often the world steps.
        strict: the first warning of an input is an error.

    Raises:
        SettingsError: a finger is missing or comes twice, a name is none, or a number is out of range.
    """

    world: str
    fingers: tuple[GazeboFinger, ...]
    poses: str | None = None
    mount: Mount = ON_THE_BODY
    rate_hz: float = 1000.0
    strict: bool = False

    def __post_init__(self) -> None:
        names = [finger.name for finger in self.fingers]
        if not names or len(set(names)) < len(names):
            raise SettingsError(f"fingers are {names}: expected names, each of them once")
        for what, topic in (("world", self.clock), ("topic of poses", self.pose_topic)):
            checked_name(what, topic)
        if not is_real(self.rate_hz) or not 1.0 <= self.rate_hz <= 1e5:
            raise SettingsError(f"rate_hz is {self.rate_hz!r}: expected steps a second, 1 to 100000")

    @property
    def clock(self) -> str:
        """The topic of the world's clock."""
        return f"/world/{self.world}/clock"

    @property
    def pose_topic(self) -> str:
        """The topic that brings poses."""
        return self.poses or f"/world/{self.world}/dynamic_pose/info"


def mount_of(text: str) -> Mount:
    """The sensor's frame in the link's, from the text of a `<pose>` in SDF: x y z, m, roll pitch yaw, rad.

    Raises:
        SettingsError: it is not six finite numbers.
    """
    try:
        numbers = np.array([float(number) for number in text.split()])
    except ValueError:
        numbers = np.empty(0)
    if numbers.shape != (6,) or not np.isfinite(numbers).all():
        raise SettingsError(f"frame {text!r}: expected 'X Y Z ROLL PITCH YAW', in m and rad, as in SDF")
    # About the fixed axes: first x, then y, then z.
    half = numbers[3:] / 2
    about = np.column_stack([np.cos(half), np.diag(np.sin(half))])
    roll, pitch, yaw = rotations(about)
    return Mount(numbers[:3], yaw @ pitch @ roll)

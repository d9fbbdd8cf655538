"""What a user says of the fingertips of a ROS 2 node."""

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from taxel.arguments import is_real
from taxel.errors import SettingsError

SHADOW_FINGERS: Final = ("ff", "mf", "rf", "lf", "th")
"""The fingers of a Shadow hand, in the order of `sr_robot_msgs/BiotacAll`."""

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


class Inputs(StrEnum):
    """Which messages bring contacts."""

    WRENCH_AND_POINT = "wrench_and_point"
    TACTILE_CONTACT = "tactile_contact"


@dataclass(frozen=True)
class NodeSettings:
    """The fingertips of a node, and what is expected of their contacts.

    Attributes:
        fingers: their names; each is the first part of its topics' names.
        frame_id: the frame that messages must name, the sensor's (`taxel.skin`); `{finger}` stands for the
            finger.
        inputs: which messages bring contacts.
        rate_hz: how often a finger's contacts come.
        pair_within_s: a wrench and a point are one contact if their stamps differ by no more, s.
        stale_after_s: after so long without a contact a finger is stale, s.
        strict: a contact that looks wrong ends the node.

    Raises:
        SettingsError: a name cannot be part of a topic's name or comes twice, or a number is out of range.
    """

    fingers: tuple[str, ...] = SHADOW_FINGERS
    frame_id: str = "{finger}_biotac"
    inputs: Inputs = Inputs.WRENCH_AND_POINT
    rate_hz: float = 100.0
    pair_within_s: float = 0.005
    stale_after_s: float = 0.5
    strict: bool = False

    def __post_init__(self) -> None:
        if not self.fingers or len(set(self.fingers)) < len(self.fingers):
            raise SettingsError(f"fingers is {list(self.fingers)}: expected names, each of them once")
        for name in self.fingers:
            if not _NAME.fullmatch(name):
                raise SettingsError(
                    f"finger {name!r}: expected a letter, then letters, digits and underscores"
                )
        for name in ("pair_within_s", "stale_after_s"):
            value = getattr(self, name)
            if not is_real(value) or not 0.0 < value < 1e6:
                raise SettingsError(f"{name} is {value!r}: expected seconds, more than 0 and below 1e6")
        if not is_real(self.rate_hz) or not 1e-3 <= self.rate_hz <= 1e5:
            raise SettingsError(f"rate_hz is {self.rate_hz!r}: expected contacts a second, 0.001 to 100000")
        try:
            self.frame_id.format(finger="ff")
        except (ValueError, KeyError, IndexError):
            raise SettingsError(
                f"frame_id is {self.frame_id!r}: expected a frame's name, with {{finger}} for the finger's"
            ) from None

    def frame_of(self, finger: str) -> str:
        """The frame that messages of this finger must name."""
        return self.frame_id.format(finger=finger)

    @property
    def is_shadow_hand(self) -> bool:
        """Whether `sr_robot_msgs/BiotacAll` has a place for every finger."""
        return set(self.fingers) <= set(SHADOW_FINGERS)

"""The messages that a node takes and gives, and how they are filled.

rclpy's classes and those of the package `rosbags` have the same names and fields, so that one text fills
both; only arrays and single bytes differ (`MessageTypes`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS, COUNTS_MAX, ELECTRODE_COLUMNS
from taxel.ros2.settings import SHADOW_FINGERS

WRENCH: Final = "geometry_msgs/msg/WrenchStamped"
POINT: Final = "geometry_msgs/msg/PointStamped"
CONTACT: Final = "tactile_msgs/msg/TactileContact"
BIOTAC: Final = "sr_robot_msgs/msg/Biotac"
BIOTAC_ALL: Final = "sr_robot_msgs/msg/BiotacAll"
CHANNEL_ARRAY: Final = "std_msgs/msg/Float32MultiArray"
DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"

DEFINITIONS: Final[Mapping[str, str]] = {
    BIOTAC: "int16 pac0\nint16 pac1\nint16 pdc\nint16 tac\nint16 tdc\nint16[] electrodes\n",
    BIOTAC_ALL: "std_msgs/Header header\nsr_robot_msgs/Biotac[5] tactiles\n",
    CONTACT: (
        "std_msgs/Header header\nstring name\ngeometry_msgs/Point position\n"
        "geometry_msgs/Vector3 normal\ngeometry_msgs/Wrench wrench\n"
    ),
}
"""Definitions of the messages that do not come with ROS 2: of Shadow Robot's `sr_robot_msgs`, and of
`tactile_msgs` of the University of Bielefeld."""


class Level(IntEnum):
    """How well something is, as in `diagnostic_msgs/DiagnosticStatus`."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Status:
    """How well a part of a node is.

    Attributes:
        name: of the part.
        level: how well it is.
        message: why.
        values: figures by name.
    """

    name: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


class MessageTypes(Protocol):
    """Classes of messages, and the few fields that they want in their own way."""

    def type_of(self, name: str) -> Any:
        """The class of a message, such as `std_msgs/msg/Header`."""

    def array(self, values: NDArray[Any]) -> Any:
        """A sequence of numbers."""

    def byte(self, value: int) -> Any:
        """A field of the type `byte`."""


def stamp_ns_of(header: Any) -> int:
    """The time of a header, ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def vector_of(value: Any) -> tuple[float, float, float]:
    """The numbers of a Point or a Vector3."""
    return float(value.x), float(value.y), float(value.z)


def header_of(types: MessageTypes, stamp_ns: int, frame_id: str = "") -> Any:
    """A Header with this time, ns, and frame."""
    stamp = types.type_of("builtin_interfaces/msg/Time")(
        sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000
    )
    return types.type_of("std_msgs/msg/Header")(stamp=stamp, frame_id=frame_id)


def channel_array(types: MessageTypes, channels: NDArray[np.float32]) -> Any:
    """A Float32MultiArray of 21 counts, in the order of `taxel.CHANNELS`."""
    size = len(CHANNELS)
    dimension = types.type_of("std_msgs/msg/MultiArrayDimension")(label="channels", size=size, stride=size)
    layout = types.type_of("std_msgs/msg/MultiArrayLayout")(dim=[dimension], data_offset=0)
    return types.type_of(CHANNEL_ARRAY)(layout=layout, data=types.array(channels.astype(np.float32)))


def biotac_all(
    types: MessageTypes,
    stamp_ns: int,
    channels: Mapping[str, NDArray[np.float32]],
    auxiliary: Mapping[str, float] | None = None,
) -> Any:
    """A BiotacAll.

    Args:
        types: whose classes to fill.
        stamp_ns: the time that the channels describe.
        channels: (21,) counts by finger, of `SHADOW_FINGERS`. A finger that is not there has no electrodes.
        auxiliary: `pac1`, `tac` and `tdc`, if they are known; models do not predict them, then they are 0.
    """
    tactiles = [_biotac(types, channels.get(finger), auxiliary or {}) for finger in SHADOW_FINGERS]
    return types.type_of(BIOTAC_ALL)(header=header_of(types, stamp_ns), tactiles=tactiles)


def _biotac(
    types: MessageTypes, channels: NDArray[np.float32] | None, auxiliary: Mapping[str, float]
) -> Any:
    counts = np.zeros(2, np.int16)
    further = dict.fromkeys(("pac1", "tac", "tdc"), 0)
    if channels is not None:
        counts = np.clip(np.rint(channels), 0, COUNTS_MAX).astype(np.int16)
        further |= {name: int(value) for name, value in auxiliary.items()}
    return types.type_of(BIOTAC)(
        pac0=int(counts[0]),
        pdc=int(counts[1]),
        electrodes=types.array(counts[ELECTRODE_COLUMNS]),
        **further,
    )


def diagnostic_array(types: MessageTypes, stamp_ns: int, statuses: Sequence[Status]) -> Any:
    """A DiagnosticArray."""
    pair, status = (
        types.type_of(f"diagnostic_msgs/msg/{name}") for name in ("KeyValue", "DiagnosticStatus")
    )
    return types.type_of(DIAGNOSTICS)(
        header=header_of(types, stamp_ns),
        status=[
            status(
                level=types.byte(one.level),
                name=one.name,
                message=one.message,
                hardware_id="",
                values=[pair(key=key, value=value) for key, value in one.values.items()],
            )
            for one in statuses
        ],
    )

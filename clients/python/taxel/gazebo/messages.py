"""Messages of Gazebo, by the field numbers of its `.proto` files (https://github.com/gazebosim/gz-msgs).

Only fields that are used are declared; protobuf passes over the others. The descriptors are made here, in a
pool of their own, so that no code need be generated, and Gazebo's own Python messages may be imported, too.
"""

from collections.abc import Set
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from numpy.typing import NDArray

from taxel.errors import InvalidArgument

CLOCK: Final = "gz.msgs.Clock"
CONTACTS: Final = "gz.msgs.Contacts"
POSES: Final = "gz.msgs.Pose_V"
CHANNELS: Final = "gz.msgs.Float_V"
"""The type of the channels: single precision as they are, and with a header, which Double_V has not."""

_FIELDS: Final[dict[str, dict[str, tuple[int, str]]]] = {
    "Time": {"sec": (1, "int64"), "nsec": (2, "int32")},
    "Header": {"stamp": (1, "Time")},
    "Clock": {"sim": (4, "Time")},
    "Vector3d": {"x": (2, "double"), "y": (3, "double"), "z": (4, "double")},
    "Quaternion": {"x": (2, "double"), "y": (3, "double"), "z": (4, "double"), "w": (5, "double")},
    "Wrench": {"force": (2, "Vector3d")},
    "JointWrench": {"body_1_wrench": (6, "Wrench")},
    "Contact": {"position": (4, "Vector3d*"), "normal": (5, "Vector3d*"), "wrench": (7, "JointWrench*")},
    "Contacts": {"contact": (2, "Contact*")},
    "Pose": {"name": (2, "string"), "position": (4, "Vector3d"), "orientation": (5, "Quaternion")},
    "Pose_V": {"pose": (2, "Pose*")},
    "Float_V": {"header": (1, "Header"), "data": (2, "float*")},
}
"""Number and type of each field; a star: repeated."""


class Touches(NamedTuple):
    """The contact points of a sensor at one moment, world frame.

    Attributes:
        points: (k, 3), m.
        forces: (k, 3), N, on one of the two bodies; it is not known on which.
        normals: (k, 3), along the contact's normal, either way; zero where none was told.
    """

    points: NDArray[np.float64]
    forces: NDArray[np.float64]
    normals: NDArray[np.float64]


class Pose(NamedTuple):
    """A pose in the frame of its parent: `position` (3,), m, and `quaternion` (4,), the scalar first."""

    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]


def decode(payload: bytes, name: str) -> Any:
    """A message of the type `name`.

    Raises:
        InvalidArgument: these bytes are none.
    """
    message = _classes()[name]()
    try:
        message.ParseFromString(payload)
    except DecodeError:
        raise InvalidArgument(f"bytes that are no {name}") from None
    return message


def sim_time_ns(clock: Any) -> int:
    """The simulated time that a `Clock` tells."""
    return int(clock.sim.sec) * 1_000_000_000 + int(clock.sim.nsec)


def touches_of(contacts: Any) -> Touches:
    """The contact points of a `Contacts`.

    Raises:
        InvalidArgument: a point has no wrench, or a number is not finite.
    """
    points, forces, normals = [], [], []
    for contact in contacts.contact:
        places, wrenches = contact.position, contact.wrench
        if len(wrenches) != len(places):
            raise InvalidArgument(
                "contacts without a wrench at each position: expected a Gazebo and a physics engine that "
                "tell contact forces (DART does)"
            )
        points += [_vector(place) for place in places]
        forces += [_vector(wrench.body_1_wrench.force) for wrench in wrenches]
        has_normals = len(contact.normal) == len(places)
        normals += [_vector(normal) for normal in contact.normal] if has_normals else [_NONE] * len(places)
    touches = Touches(*(np.array(rows, np.float64).reshape(-1, 3) for rows in (points, forces, normals)))
    if not all(np.isfinite(rows).all() for rows in touches):
        raise InvalidArgument("contacts with numbers that are not finite")
    return touches


def poses_of(poses: Any, names: Set[str]) -> dict[str, Pose | None]:
    """The poses of these names in a `Pose_V`; None where two have one name.

    Raises:
        InvalidArgument: a pose has a number that is not finite, or no orientation.
    """
    found: dict[str, Pose | None] = {}
    for pose in poses.pose:
        name = pose.name
        if name not in names:
            continue
        if name in found:
            found[name] = None
            continue
        turned = pose.orientation
        quaternion = np.array([turned.w, turned.x, turned.y, turned.z])
        position = np.array(_vector(pose.position))
        if not (np.isfinite(position).all() and np.isfinite(quaternion).all() and quaternion.any()):
            raise InvalidArgument(
                f"a pose of {name!r} that is none: expected finite numbers and an orientation"
            )
        found[name] = Pose(position, quaternion)
    return found


def channel_payload(channels: NDArray[np.float32], stamp_ns: int) -> bytes:
    """A `Float_V` of the 21 channels of one finger, counts, with the simulated time that they describe."""
    message = _classes()[CHANNELS](data=channels.tolist())
    message.header.stamp.sec, message.header.stamp.nsec = divmod(stamp_ns, 1_000_000_000)
    payload: bytes = message.SerializeToString()
    return payload


_NONE: Final = (0.0, 0.0, 0.0)


def _vector(message: Any) -> tuple[float, float, float]:
    return message.x, message.y, message.z


@cache
def _classes() -> dict[str, Any]:
    """The class of each message, by its full name."""
    file = FileDescriptorProto(name="taxel/gazebo.proto", package="gz.msgs", syntax="proto3")
    for name, fields in _FIELDS.items():
        message = file.message_type.add(name=name)
        for field, (number, kind) in fields.items():
            scalar, repeated = kind.rstrip("*"), kind.endswith("*")
            added = message.field.add(name=field, number=number)
            added.label = (
                FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
            )
            if scalar in _FIELDS:
                added.type, added.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".gz.msgs.{scalar}"
            else:
                added.type = FieldDescriptorProto.Type.Value(f"TYPE_{scalar.upper()}")
    pool = DescriptorPool()
    pool.Add(file)
    full = [f"gz.msgs.{name}" for name in _FIELDS]
    return {name: GetMessageClass(pool.FindMessageTypeByName(name)) for name in full}

"""Messages as CDR, with the types of the package `rosbags`: no ROS is needed."""

from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from taxel.errors import InvalidArgument
from taxel.ros2.messages import DEFINITIONS

_DISTRIBUTION: Final = Stores.ROS2_JAZZY
"""The definitions of this release; those of the messages used here are the same in later ones."""


@cache
def typestore() -> Typestore:
    """All message types that Taxel reads and writes."""
    store = get_typestore(_DISTRIBUTION)
    for name, definition in DEFINITIONS.items():
        store.register(get_types_from_msg(definition, name))
    return store


class CdrTypes:
    """The classes of `rosbags`, for `taxel.ros2.messages`."""

    def type_of(self, name: str) -> Any:
        """The class of a message, such as `std_msgs/msg/Header`."""
        return typestore().types[name]

    def array(self, values: NDArray[Any]) -> NDArray[Any]:
        """A sequence of numbers."""
        return np.ascontiguousarray(values)

    def byte(self, value: int) -> int:
        """A field of the type `byte`."""
        return int(value)


def encode(message: Any, name: str) -> bytes:
    """A message as little-endian CDR, with the 4 bytes of its encapsulation."""
    return bytes(typestore().serialize_cdr(message, name))


def decode(payload: bytes, name: str) -> Any:
    """A message from CDR.

    Raises:
        InvalidArgument: the bytes are no such message.
    """
    try:
        return typestore().deserialize_cdr(payload, name)
    except SerdeError as error:
        raise InvalidArgument(f"{len(payload)} bytes are no {name} in CDR: {error}") from None


def type_hash(name: str) -> str:
    """The type's hash as ROS 2 computes it, `RIHS01_` and 64 hexadecimal digits."""
    return str(typestore().hash_rihs01(name))

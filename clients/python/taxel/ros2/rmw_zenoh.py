"""How `rmw_zenoh_cpp` names and stamps things on zenoh, from Jazzy 0.2.4 and Kilted 0.6.0 on.

Written from its sources: `liveliness_utils.cpp` (keys and tokens), `qos.cpp`, `attachment_helpers.cpp`,
`rmw_publisher_data.cpp` (https://github.com/ros2/rmw_zenoh).
"""

import re
import struct
from dataclasses import dataclass
from typing import Final

import xxhash

from taxel.errors import SettingsError

TOKENS: Final = "@ros2_lv"
"""The first part of every liveliness token: nodes, publishers and subscriptions are found by them."""

_ATTACHMENT: Final = struct.Struct("<qqB16s")
_GID_BYTES: Final = 16
_DEFAULT_DEPTH: Final = 42
"""What `rmw_zenoh` takes for a depth that is not said; it is left out of the QoS text."""

_MASK: Final = 2**64 - 1
_NAME: Final = re.compile(r"/?[A-Za-z_~][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


@dataclass(frozen=True)
class Topic:
    """A topic as both ends must say it.

    Attributes:
        name: with its namespace, such as `/rh/ff/tactile`.
        type: such as `std_msgs/msg/Float32MultiArray`.
        type_hash: `RIHS01_` and 64 hexadecimal digits.
    """

    name: str
    type: str
    type_hash: str

    @property
    def dds_type(self) -> str:
        """The type in DDS' words, such as `std_msgs::msg::dds_::Float32MultiArray_`."""
        package, kind, name = self.type.split("/")
        return f"{package}::{kind}::dds_::{name}_"

    def key(self, domain: int) -> str:
        """The key that messages are published on."""
        return f"{domain}/{self.name.strip('/')}/{self.dds_type}/{self.type_hash}"


@dataclass(frozen=True)
class Qos:
    """Volatile, the last `depth` messages kept, no deadlines.

    Attributes:
        depth: how many messages are kept.
        reliable: whether lost messages are sent again.
    """

    depth: int = 10
    reliable: bool = True

    @property
    def text(self) -> str:
        """As in a token: reliability, durability, history and depth, deadline, lifespan, liveliness.

        What equals the default of `rmw_zenoh` is left out.
        """
        depth = "" if self.depth == _DEFAULT_DEPTH else str(self.depth)
        return f"{'' if self.reliable else '2'}::,{depth}:,:,:,,"


@dataclass(frozen=True)
class NodeName:
    """A node of a session, as its tokens say it.

    Attributes:
        domain: `ROS_DOMAIN_ID`.
        session: zenoh's id of the session.
        number: of the node within the session.
        name: of the node.
        namespace: `/`, or such as `/rh`.
    """

    domain: int
    session: str
    number: int
    name: str
    namespace: str = "/"

    @property
    def token(self) -> str:
        """The token that says that the node is there."""
        return self._token(self.number, "NN")

    def publisher_token(self, number: int, topic: Topic, qos: Qos) -> str:
        """The token of a publisher; `number` is its own within the session."""
        return self._entity(number, "MP", topic, qos)

    def subscription_token(self, number: int, topic: Topic, qos: Qos) -> str:
        """The token of a subscription; `number` is its own within the session."""
        return self._entity(number, "MS", topic, qos)

    def _entity(self, number: int, kind: str, topic: Topic, qos: Qos) -> str:
        name = _mangled(f"/{topic.name.strip('/')}")
        return "/".join([self._token(number, kind), name, topic.dds_type, topic.type_hash, qos.text])

    def _token(self, number: int, kind: str) -> str:
        # The enclave is always the root's.
        parts = (
            TOKENS,
            self.domain,
            self.session,
            self.number,
            number,
            kind,
            "%",
            _mangled(self.namespace),
        )
        return "/".join([*map(str, parts), self.name])


def checked_name(what: str, name: str) -> str:
    """A name of a topic, a namespace or a node, without a slash at its end.

    Raises:
        SettingsError: ROS does not allow it.
    """
    stripped = name.rstrip("/") if name != "/" else name
    if stripped != "/" and not _NAME.fullmatch(stripped):
        raise SettingsError(
            f"{what} {name!r}: expected letters, digits and underscores, with slashes between parts"
        )
    return stripped


def announced(token: str) -> Topic | None:
    """The topic that a publisher's token announces; None if the token is another one."""
    parts = token.split("/")
    if len(parts) != 13 or parts[0] != TOKENS or parts[5] != "MP":
        return None
    package, _, rest = parts[10].partition("::")
    kind, _, name = rest.partition("::dds_::")
    return Topic(parts[9].replace("%", "/"), f"{package}/{kind}/{name.removesuffix('_')}", parts[11])


def gid_of(token: str) -> bytes:
    """The 16 bytes by which receivers tell publishers apart: XXH3-128 of the token, lower half first."""
    whole = xxhash.xxh3_128_intdigest(token.encode())
    return struct.pack("<QQ", whole & _MASK, whole >> 64)


def attachment(sequence: int, time_ns: int, gid: bytes) -> bytes:
    """The 33 bytes that must go with each message: its number from 1 on, its time, and its publisher."""
    return _ATTACHMENT.pack(sequence, time_ns, _GID_BYTES, gid)


def _mangled(name: str) -> str:
    return name.replace("/", "%")

"""How Gazebo's transport names things on zenoh, from its version 15 (Jetty) on.

Written from its sources: `TopicUtils.cc` (keys and tokens), `NodeOptionsPrivate.hh` and `NetUtils.cc` (the
partition), `NodeSharedPrivate.hh` (the session), `example/zenoh/zenoh_echo.cc` (the attachment)
(https://github.com/gazebosim/gz-transport).
"""

import getpass
import json
import os
import re
import socket
from typing import Final
from uuid import uuid4

import zenoh

from taxel.endpoints import checked_endpoint, reason_of
from taxel.errors import SettingsError

_CONFIG: Final = "ZENOH_CONFIG"
_OVERRIDE: Final = "GZ_TRANSPORT_ZENOH_CONFIG_OVERRIDE"

_WRONG: Final = re.compile(r"[@~\s*$?#%]|//|:=")
"""What Gazebo does not allow in names, and zenoh not in keys."""


def own_partition() -> str:
    """The partition of Gazebo's programs that are started here: `GZ_PARTITION`, or HOST:USER."""
    partition = os.environ.get("GZ_PARTITION")
    return f"{socket.gethostname()}:{_user()}" if partition is None else partition


def _user() -> str:
    # As Gazebo asks: who owns the process, whatever the environment says.
    try:
        import pwd

        return pwd.getpwuid(os.getuid()).pw_name
    except (ImportError, KeyError):
        return getpass.getuser()


def checked_name(what: str, name: str) -> str:
    """A partition, or a topic with its slashes, without one at its end.

    Raises:
        SettingsError: Gazebo does not allow it, or it is empty.
    """
    stripped = name.removesuffix("/")
    if not stripped or _WRONG.search(stripped):
        raise SettingsError(
            f"{what} {name!r}: expected a name as `gz topic -l` shows it, without white space and "
            "any of @ ~ * $ ? # %"
        )
    return stripped


class GazeboNode:
    """A node of Gazebo's transport, as its keys and tokens say it.

    Args:
        partition: only nodes of one partition see each other.

    Raises:
        SettingsError: the partition has a name that Gazebo does not allow.
    """

    def __init__(self, partition: str) -> None:
        self._partition = partition and "/" + checked_name("partition", partition).removeprefix("/")
        self._process, self._node = uuid4(), uuid4()

    def key(self, topic: str) -> str:
        """The key of a topic, which begins with a slash."""
        return f"@{self._partition}@{topic}"

    def publisher_token(self, topic: str, name: str) -> str:
        """The token by which a publisher of messages of the type `name` is found."""
        return self._token("MP", topic, name)

    def subscription_token(self, topic: str, name: str) -> str:
        """The token of a subscription: Gazebo publishes poses only if there is one."""
        return self._token("MS", topic, name)

    def _token(self, kind: str, topic: str, name: str) -> str:
        # As in ROS, with neither enclave, namespace, node's name, type's hash nor QoS.
        parts = ("@gz", _mangled(self._partition), self._process, self._node, self._node, kind)
        return "/".join([*map(str, parts), "%", "%", "%", _mangled(topic), name, "%", "%"])


def zenoh_config(router: str | None, timeout: float) -> zenoh.Config:
    """The settings with which Gazebo's programs that are started here open zenoh.

    Args:
        router: a router or a peer to connect to; then nobody is looked for by multicast.
        timeout: seconds to wait for it.

    Raises:
        SettingsError: what the environment says is no setting of zenoh.
        InvalidArgument: `router` is no endpoint.
    """
    path = os.environ.get(_CONFIG)
    try:
        config = zenoh.Config.from_file(path) if path else zenoh.Config()
    except zenoh.ZError as error:
        raise SettingsError(f"{_CONFIG} is {path!r}: {reason_of(error)}") from None
    # Through sockets instead: a pool takes 16 MB of /dev/shm.
    config.insert_json5("transport/shared_memory/enabled", "false")
    for setting in filter(str.strip, os.environ.get(_OVERRIDE, "").split(";")):
        key, _, value = setting.partition("=")
        try:
            config.insert_json5(key.strip(), value.strip())
        except zenoh.ZError as error:
            raise SettingsError(f"{_OVERRIDE} has {setting!r}: {reason_of(error)}") from None
    if router is not None:
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("connect/endpoints", json.dumps([checked_endpoint(router)]))
        config.insert_json5("connect/timeout_ms", str(round(timeout * 1e3)))
        config.insert_json5("connect/exit_on_failure", "true")
    return config


def _mangled(name: str) -> str:
    return name.replace("/", "%")

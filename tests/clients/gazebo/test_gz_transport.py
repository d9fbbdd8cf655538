"""Keys, tokens and the session: the golden vectors are those of Gazebo's own example and of its sources."""

import os
import pwd
import re
import socket
from collections.abc import Iterator
from pathlib import Path
from uuid import UUID

import pytest

from taxel.errors import InvalidArgument, SettingsError
from taxel.gazebo import gz_transport
from taxel.gazebo.gz_transport import GazeboNode, own_partition, zenoh_config

# From gz-transport's example/zenoh/zenoh_echo.cc, with its identifiers.
PROCESS, NODE = "dce0e931-41e9-480f-8910-67d42e36978c", "1acf56d8-ae1f-4876-bbbe-577092a63c6e"
EXAMPLE = f"@gz/%zenoh/{PROCESS}/{NODE}/{NODE}/MS/%/%/%/%foo/gz.msgs.StringMsg/%/%"


@pytest.fixture
def _identified(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers: Iterator[UUID] = iter([UUID(PROCESS), UUID(NODE)])
    monkeypatch.setattr(gz_transport, "uuid4", lambda: next(numbers))


@pytest.mark.usefixtures("_identified")
def test_keys_and_tokens_are_those_of_gazebos_example() -> None:
    node = GazeboNode("zenoh")
    assert node.key("/foo") == "@/zenoh@/foo"
    assert node.subscription_token("/foo", "gz.msgs.StringMsg") == EXAMPLE
    assert node.publisher_token("/foo", "gz.msgs.StringMsg") == EXAMPLE.replace("/MS/", "/MP/")
    assert "/%world%w%clock/gz.msgs.Clock/" in node.subscription_token("/world/w/clock", "gz.msgs.Clock")


def test_each_node_has_identifiers_of_its_own() -> None:
    tokens = {GazeboNode("zenoh").subscription_token("/foo", "gz.msgs.StringMsg") for _ in range(3)}
    assert len(tokens) == 3
    uuid = "[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}"
    assert all(re.fullmatch(f"@gz/%zenoh(/{uuid}){{3}}/MS/.*", token) for token in tokens)


@pytest.mark.parametrize(
    ("partition", "key"), [("host:me", "@/host:me@/a/b"), ("/lab/", "@/lab@/a/b"), ("", "@@/a/b")]
)
def test_a_partition_in_a_key_has_one_slash_before_it(partition: str, key: str) -> None:
    assert GazeboNode(partition).key("/a/b") == key


@pytest.mark.parametrize("partition", ["a b", "a@b", "~", "a//b", "a:=b", "a*", "/"])
def test_a_partition_that_gazebo_does_not_allow_is_refused(partition: str) -> None:
    with pytest.raises(SettingsError, match=f"partition {re.escape(repr(partition))}: expected a name"):
        GazeboNode(partition)


def test_the_partition_is_that_of_the_environment_or_of_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GZ_PARTITION", "lab")
    assert own_partition() == "lab"
    monkeypatch.delenv("GZ_PARTITION")
    # Whatever a shell says of the user.
    monkeypatch.setenv("LOGNAME", "somebody_else")
    assert own_partition() == f"{socket.gethostname()}:{pwd.getpwuid(os.getuid()).pw_name}"


def test_zenohs_settings_come_from_where_gazebo_takes_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text('{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:1"]}}')
    monkeypatch.setenv("ZENOH_CONFIG", str(file))
    monkeypatch.setenv("GZ_TRANSPORT_ZENOH_CONFIG_OVERRIDE", 'mode = "peer" ; scouting/multicast/ttl=3;')
    config = zenoh_config(None, 1.0)
    assert config.get_json("mode") == '"peer"'
    assert config.get_json("scouting/multicast/ttl") == "3"
    assert config.get_json("connect/endpoints") == '["tcp/127.0.0.1:1"]'
    assert config.get_json("scouting/multicast/enabled") != "false"
    assert config.get_json("transport/shared_memory/enabled") == "false"
    routed = zenoh_config("tcp/127.0.0.1:2", 1.0)
    assert routed.get_json("connect/endpoints") == '["tcp/127.0.0.1:2"]'
    assert routed.get_json("scouting/multicast/enabled") == "false"


def test_wrong_settings_of_zenoh_are_told_by_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("GZ_TRANSPORT_ZENOH_CONFIG_OVERRIDE", "mode=nonsense")
    with pytest.raises(SettingsError, match="GZ_TRANSPORT_ZENOH_CONFIG_OVERRIDE has 'mode=nonsense'"):
        zenoh_config(None, 1.0)
    monkeypatch.setenv("ZENOH_CONFIG", str(tmp_path / "none.json5"))
    with pytest.raises(SettingsError, match=r"ZENOH_CONFIG is '.*none\.json5'"):
        zenoh_config(None, 1.0)
    monkeypatch.delenv("ZENOH_CONFIG")
    monkeypatch.delenv("GZ_TRANSPORT_ZENOH_CONFIG_OVERRIDE")
    with pytest.raises(InvalidArgument, match="is a URL"):
        zenoh_config("http://localhost:7447", 1.0)

"""Names and stamps on zenoh, held against what ROS 2 itself printed and against zenoh's own serializer."""

import pytest
import zenoh.ext
from hypothesis import given
from hypothesis import strategies as st

from taxel.errors import SettingsError
from taxel.ros2.rmw_zenoh import NodeName, Qos, Topic, announced, attachment, checked_name, gid_of

# Printed by a node of ROS 2: https://github.com/ros2/rmw_zenoh/issues/643
PARAMETER_EVENTS = (
    "@ros2_lv/0/999bf91283606d2068c7524e5badfa6c/0/8/MP/%/%robot1/talker/%parameter_events/"
    "rcl_interfaces::msg::dds_::ParameterEvent_/"
    "RIHS01_043e627780fcad87a22d225bc2a037361dba713fca6a6b9f4b869a5aa0393204/::,1000:,:,:,,"
)
ROSOUT = (
    "@ros2_lv/0/999bf91283606d2068c7524e5badfa6c/0/1/MP/%/%robot1/talker/%rosout/"
    "rcl_interfaces::msg::dds_::Log_/"
    "RIHS01_e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac/:1:,1000:,:10,0:,,"
)
TALKER = NodeName(0, "999bf91283606d2068c7524e5badfa6c", 0, "talker", "/robot1")
EVENTS = Topic(
    "/parameter_events",
    "rcl_interfaces/msg/ParameterEvent",
    "RIHS01_043e627780fcad87a22d225bc2a037361dba713fca6a6b9f4b869a5aa0393204",
)


def test_a_publishers_token_is_the_one_that_ros_declared() -> None:
    assert TALKER.publisher_token(8, EVENTS, Qos(depth=1000)) == PARAMETER_EVENTS


def test_tokens_of_ros_are_read() -> None:
    assert announced(PARAMETER_EVENTS) == EVENTS
    log = announced(ROSOUT)
    assert log is not None
    assert (log.name, log.type) == ("/rosout", "rcl_interfaces/msg/Log")


@pytest.mark.parametrize(
    "token",
    [
        "",
        "@ros2_lv/0/abc/0/0/NN/%/%/talker",
        PARAMETER_EVENTS.replace("/MP/", "/MS/"),
        PARAMETER_EVENTS.replace("@ros2_lv", "@other"),
    ],
)
def test_other_tokens_announce_no_topic(token: str) -> None:
    assert announced(token) is None


def test_a_node_and_a_subscription_in_the_root_namespace() -> None:
    node = NodeName(7, "abc", 3, "taxel")
    assert node.token == "@ros2_lv/7/abc/3/3/NN/%/%/taxel"
    topic = Topic("/rh/ff/wrench", "geometry_msgs/msg/WrenchStamped", "RIHS01_00")
    assert node.subscription_token(4, topic, Qos(5, reliable=False)) == (
        "@ros2_lv/7/abc/3/4/MS/%/%/taxel/%rh%ff%wrench/geometry_msgs::msg::dds_::WrenchStamped_/RIHS01_00/"
        "2::,5:,:,:,,"
    )
    assert topic.key(7) == "7/rh/ff/wrench/geometry_msgs::msg::dds_::WrenchStamped_/RIHS01_00"


def test_what_rmw_zenoh_takes_by_default_is_left_out_of_the_qos() -> None:
    assert Qos().text == "::,10:,:,:,,"
    assert Qos(42).text == "::,:,:,:,,"


@given(st.integers(1, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_attachments_are_those_of_zenohs_serializer(sequence: int, time_ns: int, gid: bytes) -> None:
    expected = zenoh.ext.z_serialize((zenoh.ext.Int64(sequence), zenoh.ext.Int64(time_ns), gid))
    assert attachment(sequence, time_ns, gid) == expected.to_bytes()
    assert len(expected.to_bytes()) == 33


def test_the_gid_is_the_hash_of_the_token() -> None:
    # XXH3-128 of no bytes, from xxHash's own description; the whole as one little-endian number.
    assert gid_of("") == bytes.fromhex("99aa06d3014798d86001c324468d497f")[::-1]
    assert gid_of(PARAMETER_EVENTS) != gid_of(ROSOUT)


@pytest.mark.parametrize("name", ["", "1st", "a b", "a//b", "ä", "a/1", "*", "$x"])
def test_names_that_ros_does_not_allow_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match="expected letters"):
        checked_name("namespace", name)


def test_names_lose_their_last_slash() -> None:
    assert checked_name("namespace", "/rh/") == "/rh"
    assert checked_name("namespace", "/") == "/"

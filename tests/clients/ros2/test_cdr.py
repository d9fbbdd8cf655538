"""Messages as CDR: known bytes, hashes that ROS 2's own generator gives, and damaged bytes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxel.errors import InvalidArgument
from taxel.ros2.cdr import CdrTypes, decode, encode, type_hash
from taxel.ros2.messages import (
    BIOTAC,
    BIOTAC_ALL,
    CHANNEL_ARRAY,
    CONTACT,
    DIAGNOSTICS,
    POINT,
    WRENCH,
    Level,
    Status,
    biotac_all,
    channel_array,
    diagnostic_array,
)

TYPES = CdrTypes()
# Those of Biotac and BiotacAll are what rosidl_generator_type_description of ROS 2 Kilted gives, too.
HASHES = {
    BIOTAC: "89d7efea5e9554cfc61491cd2d625ef7214ee40c481411499921200d99ab77d4",
    BIOTAC_ALL: "d948cd8b08fb197cb6fb9df355197583847d419bedbb08b80b2079200ed6325c",
    CONTACT: "94503ed59419d3bf0570843f2a5b7cb4e01130d3d7641a2fa5d7c731bc6b7bde",
    CHANNEL_ARRAY: "0599f6f85b4bfca379873a0b4375a0aca022156bd2d7021275d116ed1fa8bfe0",
    WRENCH: "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    POINT: "4c0296af86e01e562e9e0405d138a01537247580076c58ea38d7923ac1045897",
}


@pytest.mark.parametrize("name", HASHES)
def test_hashes_are_those_of_ros(name: str) -> None:
    assert type_hash(name) == f"RIHS01_{HASHES[name]}"


def test_a_string_has_the_bytes_that_ros_writes() -> None:
    text = TYPES.type_of("std_msgs/msg/String")(data="hi")
    assert encode(text, "std_msgs/msg/String").hex() == "0001000003000000686900"


def test_a_hand_has_counts_where_there_are_fingers() -> None:
    channels = np.linspace(-20.0, 5000.0, 21).astype(np.float32)
    message = decode(
        encode(biotac_all(TYPES, 1_700_000_000_123_456_789, {"mf": channels}), BIOTAC_ALL), BIOTAC_ALL
    )
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    middle = message.tactiles[1]
    assert (middle.pac0, middle.pdc) == (0, 231)
    assert middle.electrodes.tolist() == np.clip(np.rint(channels[2:]), 0, 4095).tolist()
    for place in (0, 2, 3, 4):
        assert len(message.tactiles[place].electrodes) == 0


def test_an_array_has_one_dimension() -> None:
    message = decode(
        encode(channel_array(TYPES, np.arange(21, dtype=np.float32)), CHANNEL_ARRAY), CHANNEL_ARRAY
    )
    assert [(one.label, one.size, one.stride) for one in message.layout.dim] == [("channels", 21, 21)]
    assert message.data.tolist() == list(range(21))


def test_diagnostics_have_levels_and_values() -> None:
    statuses = [Status("a", Level.WARN, "why", {"rate_hz": "99.9"})]
    message = decode(encode(diagnostic_array(TYPES, 5, statuses), DIAGNOSTICS), DIAGNOSTICS)
    (status,) = message.status
    assert (status.level, status.name, status.message) == (1, "a", "why")
    assert [(pair.key, pair.value) for pair in status.values] == [("rate_hz", "99.9")]


@given(st.binary(max_size=200), st.sampled_from([WRENCH, POINT, CONTACT]))
def test_foreign_bytes_are_refused_or_read(payload: bytes, name: str) -> None:
    try:
        read = encode(decode(b"\x00\x01\x00\x00" + payload, name), name)
    except InvalidArgument:
        return
    assert encode(decode(read, name), name) == read


def test_a_message_that_was_cut_is_refused() -> None:
    whole = encode(biotac_all(TYPES, 1, {"ff": np.zeros(21, np.float32)}), BIOTAC_ALL)
    for length in range(len(whole)):
        with pytest.raises(InvalidArgument, match="are no sr_robot_msgs/msg/BiotacAll"):
            decode(whole[:length], BIOTAC_ALL)

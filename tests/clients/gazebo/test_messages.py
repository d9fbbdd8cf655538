"""Messages against the bytes of an independent program, which has the whole of Gazebo's definitions."""

from typing import Any

import numpy as np
import pytest
from google.protobuf import json_format

from taxel.errors import InvalidArgument
from taxel.gazebo import messages
from taxel.gazebo.messages import (
    CHANNELS,
    CLOCK,
    CONTACTS,
    POSES,
    channel_payload,
    decode,
    poses_of,
    sim_time_ns,
    touches_of,
)

Json = dict[str, Any]


def vector(x: float, y: float, z: float) -> Json:
    return {"x": x, "y": y, "z": z}


def bytes_of(gz: Json, name: str, message: Json) -> bytes:
    payload: bytes = json_format.ParseDict(message, gz[name]()).SerializeToString()
    return payload


STAMP = {"stamp": {"sec": 7, "nsec": 12}, "data": [{"key": "frame_id", "value": ["world"]}]}
FULL: Json = {
    "header": STAMP,
    "contact": [
        {
            "header": STAMP,
            "collision1": {"id": 11, "name": "hand::tip::pad", "type": 5},
            "collision2": {"id": 16, "name": "box::link::box"},
            "position": [vector(1, 2, 3), vector(4, 5, 6)],
            "normal": [vector(0, 0, 1), vector(0, 1, 0)],
            "depth": [0.001, 0.002],
            "wrench": [
                {
                    "body_1_name": "one",
                    "body_1_id": 11,
                    "body_1_wrench": {"force": vector(*force), "torque": vector(9, 9, 9)},
                    "body_2_wrench": {"force": vector(*(-one for one in force))},
                }
                for force in [(0.1, 0.2, 0.3), (0.4, 0.5, 0.6)]
            ],
            "world": {"name": "shapes"},
        },
        {"position": [vector(7, 8, 9)], "wrench": [{"body_1_wrench": {"force": vector(-1, 0, 0)}}]},
        {"collision1": {"id": 1}},
    ],
}


def test_contacts_are_read_from_a_whole_message(gz: Json) -> None:
    touches = touches_of(decode(bytes_of(gz, CONTACTS, FULL), CONTACTS))
    assert touches.points.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
    assert touches.forces.tolist() == [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [-1, 0, 0]]
    assert touches.normals.tolist() == [[0, 0, 1], [0, 1, 0], [0, 0, 0]]


def test_no_contacts_are_none(gz: Json) -> None:
    assert [len(rows) for rows in touches_of(decode(b"", CONTACTS))] == [0, 0, 0]


def test_a_clock_is_read(gz: Json) -> None:
    clock = {"system": {"sec": 99}, "real": {"sec": 98}, "sim": {"sec": 7, "nsec": 12}}
    assert sim_time_ns(decode(bytes_of(gz, CLOCK, clock), CLOCK)) == 7_000_000_012
    # The same by hand: field 4, 4 bytes: field 1 is 7, field 2 is 12.
    assert sim_time_ns(decode(bytes.fromhex("2204 0807 100c"), CLOCK)) == 7_000_000_012


def test_poses_are_read_by_name_and_two_of_one_name_are_none(gz: Json) -> None:
    turned = {"x": 0.1, "y": 0.2, "z": 0.3, "w": 0.9}
    pose = {"name": "tip", "id": 3, "header": STAMP, "position": vector(1, 2, 3), "orientation": turned}
    rest = {"position": vector(0, 0, 0), "orientation": {"w": 1}}
    message = {"pose": [pose, {**rest, "name": "a"}, {**rest, "name": "a"}, {**rest, "name": "a"}]}
    poses = poses_of(decode(bytes_of(gz, POSES, message), POSES), {"a", "tip", "b"})
    assert poses.keys() == {"a", "tip"}
    assert poses["a"] is None
    assert poses["tip"] is not None
    assert poses["tip"].position.tolist() == [1, 2, 3]
    assert poses["tip"].quaternion.tolist() == [0.9, 0.1, 0.2, 0.3]


def test_channels_are_read_by_others(gz: Json) -> None:
    channels = np.linspace(0.1, 4095.0, 21, dtype=np.float32)
    message = gz[CHANNELS].FromString(channel_payload(channels, 7_000_000_012))
    np.testing.assert_array_equal(np.array(message.data, np.float32), channels)
    assert (message.header.stamp.sec, message.header.stamp.nsec) == (7, 12)
    # Packed, as protobuf's third syntax says: header 4 bytes long, then 8 bytes of data.
    two = np.array([1.0, -2.0], np.float32)
    assert (
        channel_payload(two, 7_000_000_012).hex() == "0a060a040807100c" + "1208" + "0000803f" + "000000c0"
    )


def test_every_field_has_gazebos_number_and_type(gz: Json) -> None:
    compared = 0
    for name, own in messages._classes().items():
        theirs = gz[name].DESCRIPTOR.fields_by_name
        for field in own.DESCRIPTOR.fields:
            other = theirs[field.name]
            assert (field.number, field.type, field.is_repeated) == (
                other.number,
                other.type,
                other.is_repeated,
            )
            if field.message_type is not None:
                assert field.message_type.full_name == other.message_type.full_name
            compared += 1
    assert compared == sum(map(len, messages._FIELDS.values()))


@pytest.mark.parametrize("name", [CLOCK, CONTACTS, POSES])
@pytest.mark.parametrize("payload", [b"\xff" * 12, b"\x12\x7f", b"nonsense"])
def test_other_bytes_are_refused_by_name(name: str, payload: bytes) -> None:
    with pytest.raises(InvalidArgument, match=f"^bytes that are no {name}$"):
        decode(payload, name)


def test_contacts_without_forces_are_refused(gz: Json) -> None:
    contacts = {"contact": [{"position": [vector(1, 2, 3)]}]}
    with pytest.raises(InvalidArgument, match="without a wrench at each position"):
        touches_of(decode(bytes_of(gz, CONTACTS, contacts), CONTACTS))


@pytest.mark.parametrize("field", ["position", "normal", "wrench"])
@pytest.mark.parametrize("bad", ["NaN", "Infinity"])
def test_contacts_that_are_not_finite_are_refused(gz: Json, field: str, bad: str) -> None:
    contact: Json = {"position": [vector(1, 2, 3)], "normal": [vector(0, 0, 1)], "wrench": [{}]}
    wrong = {"x": bad}
    contact[field] = [{"body_1_wrench": {"force": wrong}}] if field == "wrench" else [wrong]
    message = decode(bytes_of(gz, CONTACTS, {"contact": [contact]}), CONTACTS)
    with pytest.raises(InvalidArgument, match="not finite"):
        touches_of(message)


@pytest.mark.parametrize(
    "pose", [{}, {"orientation": {"w": "NaN"}}, {"orientation": {"w": 1}, "position": {"x": "Infinity"}}]
)
def test_poses_that_are_none_are_refused(gz: Json, pose: Json) -> None:
    message = decode(bytes_of(gz, POSES, {"pose": [{"name": "tip", **pose}]}), POSES)
    with pytest.raises(InvalidArgument, match="a pose of 'tip' that is none"):
        poses_of(message, {"tip"})
    assert poses_of(message, {"hand"}) == {}

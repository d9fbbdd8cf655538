"""From Gazebo's messages to channels, held against fingers that are given the same touches by hand."""

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from google.protobuf import json_format
from numpy.typing import NDArray

import taxel
from taxel.errors import InputWarning, InvalidArgument
from taxel.gazebo.messages import CLOCK, CONTACTS, POSES
from taxel.gazebo.settings import BridgeSettings, GazeboFinger, mount_of
from taxel.gazebo.tactile_bridge import Prediction, TactileBridge, on_finger
from taxel.predictor import Predictor
from taxel.skin import PAD, Fingertip

Json = dict[str, Any]
Vector = NDArray[np.float64]

STEP_NS = 1_000_000
HALF = math.sqrt(0.5)
PRESS = np.array([0.1, 0.0, 1.2])
"""On the finger, N: on the pad it points inwards."""

# The hand stands at (1, 2, 3), turned by 90 degrees about z; the tip in it at (0.1, 0, 0), turned by 90
# degrees about x; and the sensor's frame 20 mm along the tip's x.
HAND: Json = {"name": "hand", "position": {"x": 1, "y": 2, "z": 3}, "orientation": {"z": HALF, "w": HALF}}
TIP: Json = {"name": "tip", "position": {"x": 0.1}, "orientation": {"x": HALF, "w": HALF}}
TURNED = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
ORIGIN = np.array([1.0, 2.1, 3.0]) + TURNED @ np.array([0.02, 0, 0])
MOUNT = mount_of("0.02 0 0 0 0 0")

FF = GazeboFinger.parsed("ff=hand/tip/touch", "w")
SETTINGS = BridgeSettings("w", (FF,), mount=MOUNT)


def xyz(vector: Vector) -> Json:
    return dict(zip("xyz", map(float, vector), strict=True))


def contacts(*touches: tuple[Vector, Vector], normals: Any = None, sign: int = 1) -> Json:
    """Of places and forces on the finger, in the sensor's frame: as Gazebo tells them, in the world's."""
    contact: Json = {
        "position": [xyz(ORIGIN + TURNED @ place) for place, _ in touches],
        "wrench": [
            {
                "body_1_wrench": {"force": xyz(sign * TURNED @ force)},
                "body_2_wrench": {"force": xyz(-sign * TURNED @ force)},
            }
            for _, force in touches
        ],
    }
    if normals is not None:
        contact["normal"] = [xyz(TURNED @ np.asarray(normal, float)) for normal in normals]
    return {"contact": [contact]}


class World:
    """Steps of a world: first its clock, then poses and contacts, as Gazebo publishes them."""

    def __init__(self, gz: Json, bridge: TactileBridge) -> None:
        self._gz, self.bridge, self.time_ns = gz, bridge, 5_000_000_000
        self.given: list[Prediction] = []

    def payload(self, name: str, content: Json) -> bytes:
        payload: bytes = json_format.ParseDict(content, self._gz[name]()).SerializeToString()
        return payload

    def step(self, touching: Json | None = None, finger: int = 0, after_ns: int = STEP_NS) -> None:
        self.time_ns += after_ns
        sec, nsec = divmod(self.time_ns, 1_000_000_000)
        given = self.bridge.take_clock(self.payload(CLOCK, {"sim": {"sec": sec, "nsec": nsec}}))
        if given is not None:
            self.given.append(given)
        if touching is not None:
            self.bridge.take_contacts(finger, self.payload(CONTACTS, touching))

    def poses(self, *poses: Json) -> None:
        self.bridge.take_poses(self.payload(POSES, {"pose": list(poses)}))


@pytest.fixture
def world(gz: Json, predictor: Predictor) -> World:
    world = World(gz, TactileBridge(predictor, SETTINGS))
    world.poses(HAND, TIP)
    return world


class ByHand:
    """Fingers that are told places and forces in the sensor's frame, at every tenth step of the world."""

    def __init__(
        self, predictor: Predictor, count: int = 1, every: int = 10, rate_hz: float = 100.0
    ) -> None:
        self._fingers = predictor.fingers(count, rate_hz=rate_hz)
        self._every, self._steps = every, 0
        self._place = np.tile(np.array(PAD), (count, 1))
        self.given: list[NDArray[np.float32]] = []

    def step(
        self, touch: tuple[Vector, Vector] | None = None, finger: int = 0, dt: float | None = None
    ) -> None:
        self._steps += 1
        if (self._steps - 1) % self._every:
            return
        force = np.zeros_like(self._place)
        if touch is not None:
            self._place = self._place.copy()
            self._place[finger] = Fingertip.biotac_2p().nearest(touch[0][None])[0]
            force[finger] = touch[1]
        before = self._fingers.channels
        channels = self._fingers.step(self._place, force, dt)
        if self._fingers.channels is not before:
            self.given.append(channels)


def assert_same(world: World, by_hand: ByHand) -> None:
    assert len(world.given) == len(by_hand.given) > 1
    for one, channels in zip(world.given, by_hand.given, strict=True):
        np.testing.assert_allclose(one.channels, channels, rtol=0, atol=1e-3)


def pressed(predictor: Predictor, steps: int, force: Vector = PRESS) -> ByHand:
    by_hand = ByHand(predictor)
    for step in range(steps):
        by_hand.step((np.array(PAD), force) if step >= 10 else None)
    return by_hand


PAD_PLACE = np.array(PAD)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("normal", [None, (0, 0, 1), (0, 0, -1)])
def test_pressing_a_pad_pushes_into_the_finger_whichever_body_gazebo_tells(
    world: World, predictor: Predictor, sign: int, normal: Any
) -> None:
    touching = contacts((PAD_PLACE, PRESS), sign=sign, normals=normal and [normal])
    for step in range(61):
        world.step(touching if step >= 10 else None)
    by_hand = pressed(predictor, 60)
    assert_same(world, by_hand)
    # And a pull would have given other channels.
    other = pressed(predictor, 60, -PRESS)
    assert np.abs(other.given[-1] - by_hand.given[-1]).max() > 1.0


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_sign_is_that_of_the_normal_where_friction_is_larger(sign: int, side: float) -> None:
    skin = Fingertip.biotac_2p()
    around = np.linspace(-1.5, 1.5, 7)
    points = skin.radius * np.column_stack([np.zeros(7), np.sin(around), -np.cos(around)])
    outward = skin.normal(points)
    sideways = np.column_stack([np.zeros(7), np.cos(around), np.sin(around)])
    forces = -0.2 * outward + 1.0 * sideways
    # Gazebo's normal is that of the other body's surface, too: somewhat turned against the skin's.
    normals = side * (outward + 0.1 * sideways)
    np.testing.assert_array_equal(on_finger(points, sign * forces, normals), forces)


def test_the_stamp_is_that_of_the_step_with_the_contacts(world: World, predictor: Predictor) -> None:
    by_hand = ByHand(predictor)
    for _ in range(45):
        world.step()
    for _ in range(44):
        by_hand.step()
    assert_same(world, by_hand)
    stamps = np.array([one.stamp_ns for one in world.given])
    assert stamps[0] == 5_000_000_000 + STEP_NS
    np.testing.assert_array_equal(np.diff(stamps), [10 * STEP_NS] * 4)


@pytest.mark.parametrize(("rate_hz", "step_ns"), [(250.0, 4_000_000), (300.0, 3_330_000)])
def test_steps_that_do_not_divide_ten_milliseconds_are_all_taken(
    gz: Json, predictor: Predictor, rate_hz: float, step_ns: int
) -> None:
    settings = BridgeSettings("w", (FF,), mount=MOUNT, rate_hz=rate_hz)
    world = World(gz, TactileBridge(predictor, settings))
    world.poses(HAND, TIP)
    by_hand = ByHand(predictor, every=1, rate_hz=rate_hz)
    for step in range(40):
        force = PRESS * (1.0 + 0.01 * step)
        world.step(contacts((PAD_PLACE, force)), after_ns=step_ns)
        by_hand.step((PAD_PLACE, force), dt=step_ns / 1e9 if step else None)
    world.step(after_ns=step_ns)
    assert_same(world, by_hand)


def test_a_sensor_that_falls_silent_touches_nothing(world: World, predictor: Predictor) -> None:
    by_hand = ByHand(predictor)
    for step in range(80):
        on = 10 <= step < 40
        world.step(contacts((PAD_PLACE, PRESS)) if on else None)
        by_hand.step((PAD_PLACE, PRESS) if on else None)
    world.step()
    assert_same(world, by_hand)


def test_contacts_that_belong_together_are_one(world: World, predictor: Predictor) -> None:
    beside = PAD_PLACE + np.array([-0.002, 0.0, 0.0])
    touching = contacts((PAD_PLACE, PRESS / 2), (beside, PRESS / 2))
    by_hand = ByHand(predictor)
    for _ in range(30):
        world.step(touching)
        by_hand.step(((PAD_PLACE + beside) / 2, PRESS))
    world.step()
    assert_same(world, by_hand)


def test_a_paused_world_steps_no_finger(world: World, predictor: Predictor) -> None:
    for _ in range(20):
        world.step(contacts((PAD_PLACE, PRESS)))
        world.step(contacts((PAD_PLACE, PRESS)), after_ns=0)
    world.step()
    by_hand = ByHand(predictor)
    for _ in range(20):
        by_hand.step((PAD_PLACE, PRESS))
    assert_same(world, by_hand)


def test_a_world_that_began_again_begins_the_fingers_again(world: World, predictor: Predictor) -> None:
    for _ in range(30):
        world.step(contacts((PAD_PLACE, PRESS)))
    world.given.clear()
    world.step(after_ns=-3_000_000_000)
    for _ in range(30):
        world.step()
    by_hand = ByHand(predictor)
    for _ in range(30):
        by_hand.step()
    assert_same(world, by_hand)


def test_each_finger_has_contacts_and_a_pose_of_its_own(gz: Json, predictor: Predictor) -> None:
    th = GazeboFinger.parsed("th=hand/thumb/touch", "w")
    world = World(gz, TactileBridge(predictor, BridgeSettings("w", (th, FF), mount=MOUNT)))
    # The thumb is elsewhere: with its pose, the tip's contacts would be off the skin.
    world.poses(HAND, TIP, {"name": "thumb", "position": {"y": 5}, "orientation": {"w": 1}})
    by_hand = ByHand(predictor, 2)
    for _ in range(30):
        world.step(contacts((PAD_PLACE, PRESS)), finger=1)
        by_hand.step((PAD_PLACE, PRESS), finger=1)
    world.step()
    assert_same(world, by_hand)
    assert np.abs(np.diff(world.given[-1].channels, axis=0)).max() > 1.0


SCOPED: list[Json] = [HAND, {**TIP, "name": "hand::tip"}, {**TIP, "name": "tip", "position": {"x": 9}}]
NESTED: list[Json] = [
    {"name": "robot", "position": {"x": -1, "y": -2, "z": -3}, "orientation": {"w": 1}},
    {"name": "hand", "position": {"x": 2, "y": 4, "z": 6}, "orientation": {"z": HALF, "w": HALF}},
    TIP,
]


@pytest.mark.parametrize(
    ("finger", "poses"), [("ff=hand/tip/touch", SCOPED), ("ff=robot/hand/tip/touch", NESTED)]
)
def test_poses_may_be_of_a_pose_publisher_or_of_models_in_models(
    gz: Json, predictor: Predictor, finger: str, poses: list[Json]
) -> None:
    settings = BridgeSettings("w", (GazeboFinger.parsed(finger, "w"),), mount=MOUNT)
    world, by_hand = World(gz, TactileBridge(predictor, settings)), ByHand(predictor)
    world.poses(*poses)
    for _ in range(30):
        world.step(contacts((PAD_PLACE, PRESS)))
        by_hand.step((PAD_PLACE, PRESS))
    world.step()
    assert_same(world, by_hand)


def test_a_pose_that_changes_is_followed(world: World, predictor: Predictor) -> None:
    by_hand = ByHand(predictor)
    for step in range(30):
        moved = {**HAND, "position": {"x": 1 + 0.01 * step, "y": 2, "z": 3}}
        there = PAD_PLACE + TURNED.T @ np.array([0.01 * step, 0.0, 0.0])
        world.step(contacts((there, PRESS)))
        by_hand.step((PAD_PLACE, PRESS))
        # Poses of a step come after its clock.
        world.poses(moved, TIP)
    world.step()
    assert_same(world, by_hand)


def test_a_finger_without_a_pose_is_told_by_name(gz: Json, predictor: Predictor) -> None:
    world = World(gz, TactileBridge(predictor, SETTINGS))
    world.poses({"name": "table", "orientation": {"w": 1}})
    world.step(contacts((PAD_PLACE, PRESS)))
    with pytest.warns(
        InputWarning, match="^/world/.*/contact: /world/w/dynamic_pose/info has no pose of 'hand'"
    ):
        world.step()
    world.poses(HAND, TIP, TIP)
    for _ in range(9):
        world.step(contacts((PAD_PLACE, PRESS)))
    with pytest.warns(InputWarning, match="has two poses of 'tip': expected names that differ"):
        world.step()
    assert world.bridge.refused == 2


def test_contacts_before_the_first_poses_are_waited_with(gz: Json, predictor: Predictor) -> None:
    world, by_hand = World(gz, TactileBridge(predictor, SETTINGS)), ByHand(predictor)
    for _ in range(30):
        world.step(contacts((PAD_PLACE, PRESS)))
    assert world.given == []
    world.poses(HAND, TIP)
    for _ in range(30):
        world.step(contacts((PAD_PLACE, PRESS)))
        by_hand.step((PAD_PLACE, PRESS))
    assert_same(world, by_hand)
    assert world.bridge.refused == 0


def test_poses_that_never_come_are_told(gz: Json, predictor: Predictor) -> None:
    world = World(gz, TactileBridge(predictor, SETTINGS))
    for _ in range(1001):
        world.step(contacts((PAD_PLACE, PRESS)))
    assert world.bridge.refused == 0
    with pytest.warns(InputWarning, match="/world/w/dynamic_pose/info has no pose of 'hand'"):
        world.step()


GRAMS = PRESS * 101.97
STRICT = replace(SETTINGS, strict=True)


@pytest.mark.parametrize(
    ("touch", "text"),
    [
        ((PAD_PLACE, GRAMS), "forces up to 122.8 look like grams: expected newtons"),
        ((PAD_PLACE * 1e3, PRESS), "look like millimetres, expected metres"),
        ((np.array([0.0, 0.0, -0.03]), PRESS), "contacts are more than 4 mm off the skin"),
        (b"nonsense", "/contact: bytes that are no gz.msgs.Contacts"),
    ],
)
def test_a_strict_bridge_ends_at_the_first_input_that_looks_wrong(
    gz: Json, predictor: Predictor, touch: Any, text: str
) -> None:
    with pytest.warns(InputWarning, match=text):
        _told_of(World(gz, TactileBridge(predictor, SETTINGS)), touch)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InvalidArgument, match=text):
            _told_of(World(gz, TactileBridge(predictor, STRICT)), touch)


def _told_of(world: World, touch: Any) -> None:
    world.poses(HAND, TIP)
    for _ in range(15):
        world.step(None if isinstance(touch, bytes) else contacts(touch))
        if isinstance(touch, bytes):
            world.bridge.take_contacts(0, touch)


def test_a_strict_bridge_takes_what_is_right(gz: Json, predictor: Predictor) -> None:
    world, by_hand = World(gz, TactileBridge(predictor, STRICT)), ByHand(predictor)
    world.poses(HAND, TIP)
    for _ in range(60):
        world.step(contacts((PAD_PLACE, PRESS)))
        by_hand.step((PAD_PLACE, PRESS))
    world.step()
    assert_same(world, by_hand)


def test_a_strict_bridge_refuses_a_world_that_steps_too_slowly(predictor: Predictor) -> None:
    with pytest.raises(InvalidArgument, match="a sample every 50 ms: expected one every 10 ms"):
        TactileBridge(predictor, replace(STRICT, rate_hz=20.0))


def test_contacts_of_another_frame_are_told(world: World) -> None:
    world.step(contacts((np.array([0.0, 0.0, -0.03]), PRESS)))
    with pytest.warns(InputWarning, match="contacts are more than 4 mm off the skin"):
        world.step()


def test_contacts_that_cannot_be_used_are_left_out_alone(gz: Json, predictor: Predictor) -> None:
    th = GazeboFinger.parsed("th=hand/thumb/touch", "w")
    world = World(gz, TactileBridge(predictor, BridgeSettings("w", (FF, th), mount=MOUNT)))
    world.poses(HAND, TIP, {**TIP, "name": "thumb"})
    bad = [b"nonsense", world.payload(CONTACTS, {"contact": [{"position": [{}]}]})]
    by_hand = ByHand(predictor, 2)

    def steps() -> None:
        for step in range(40):
            world.step(contacts((PAD_PLACE, PRESS)))
            world.bridge.take_contacts(1, bad[step // 10 % 2])
            by_hand.step((PAD_PLACE, PRESS))
        world.step()

    with pytest.warns(InputWarning) as told:
        steps()
    assert_same(world, by_hand)
    assert world.bridge.refused == 4
    reasons = {str(one.message).partition("/contact: ")[2].partition(":")[0] for one in told}
    assert reasons == {"bytes that are no gz.msgs.Contacts", "contacts without a wrench at each position"}


@pytest.fixture
def closed() -> Predictor:
    with taxel.load() as models:
        return models.predictor()


def test_a_prediction_that_cannot_be_had_is_told_and_the_world_goes_on(gz: Json, closed: Predictor) -> None:
    world = World(gz, TactileBridge(closed, SETTINGS))
    world.step()
    with pytest.warns(InputWarning, match="no prediction: "):
        world.step()
    assert world.given == []


def test_a_server_that_does_not_answer_does_not_end_a_strict_bridge(gz: Json, closed: Predictor) -> None:
    world = World(gz, TactileBridge(closed, STRICT))
    world.step()
    with pytest.warns(InputWarning, match="no prediction: "):
        world.step()

"""`taxel gazebo` through real zenoh, with an independent program that speaks as Gazebo's sources say."""

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
import zenoh
from google.protobuf import json_format
from zenoh.handlers import Callback

from taxel.errors import InputWarning, Unavailable
from taxel.gazebo import zenoh_bridge
from taxel.gazebo.messages import CHANNELS, CLOCK, CONTACTS, POSES
from taxel.gazebo.settings import BridgeSettings, GazeboFinger
from taxel.gazebo.tactile_bridge import Prediction
from taxel.gazebo.zenoh_bridge import ZenohBridge
from taxel.predictor import Predictor
from taxel.skin import PAD

Json = dict[str, Any]

FINGERS = tuple(GazeboFinger.parsed(f"{name}=hand/{name}_tip/touch", "w") for name in ("ff", "th"))
SETTINGS = BridgeSettings("w", FINGERS)
CLOCK_TOPIC, POSE_TOPIC = "/world/w/clock", "/world/w/dynamic_pose/info"
FF_TOPIC = "/world/w/model/hand/link/ff_tip/sensor/touch/contact"

PRESS = np.array([0.0, 0.1, 0.9])
POSES_OF_HAND: Json = {
    "pose": [
        {"name": name, "position": {"x": x}, "orientation": {"w": 1}}
        for name, x in (("hand", 1.0), ("ff_tip", 0.5), ("th_tip", 0.7))
    ]
}
# On the table: whatever touches the finger is at x = 1.5 in the world, and Gazebo tells the force on it.
TOUCHING: Json = {
    "contact": [
        {
            "position": [{"x": 1.5, "y": PAD[1], "z": PAD[2]}],
            "normal": [{"z": -1}],
            "wrench": [{"body_1_wrench": {"force": {"y": -PRESS[1], "z": -PRESS[2]}}}],
        }
    ]
}


def clock(step: int) -> Json:
    sec, nsec = divmod(3_000_000_000 + step * 1_000_000, 1_000_000_000)
    return {"sim": {"sec": sec, "nsec": nsec}}


def published(steps: int) -> list[Json]:
    """What a world publishes, in its order; the finger is touched in every step but the first five."""
    messages: list[Json] = []
    for step in range(steps + 1):
        messages.append({"topic": CLOCK_TOPIC, "type": CLOCK, "message": clock(step)})
        if step >= 5:
            messages.append({"topic": FF_TOPIC, "type": CONTACTS, "message": TOUCHING})
        messages.append({"topic": POSE_TOPIC, "type": POSES, "message": POSES_OF_HAND})
    return messages


def by_hand(predictor: Predictor, steps: int) -> list[Any]:
    """The channels (2, 21) that fingers give which are told every tenth step, in the sensors' frames."""
    fingers, given = predictor.fingers(2), []
    for step in range(0, steps, 10):
        before = fingers.channels
        force = np.array([PRESS if step >= 5 else np.zeros(3), np.zeros(3)])
        channels = fingers.step(np.tile(PAD, (2, 1)), force)
        if fingers.channels is not before:
            given.append(channels)
    return given


def listens(host: str, port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((host, port)) == 0


def until(happened: Callable[[], bool]) -> None:
    """Wait for what must happen."""
    for _ in range(3000):
        if happened():
            return
        time.sleep(0.02)
    pytest.fail("it never happened")


@contextmanager
def running(
    predictor: Predictor,
    endpoint: str,
    on_prediction: Callable[[Prediction], None] | None = None,
    **more: Any,
) -> Iterator[ZenohBridge]:
    with ZenohBridge(predictor, SETTINGS, partition="lab", router=endpoint, **more) as bridge:
        thread = threading.Thread(target=bridge.run, args=(on_prediction,))
        thread.start()
        try:
            yield bridge
        finally:
            bridge.stop()
            thread.join(60)
        assert not thread.is_alive()


def test_an_independent_program_speaks_with_it_both_ways(
    predictor: Predictor, endpoint: str, command: list[str], tmp_path: Path
) -> None:
    expected = by_hand(predictor, 60)
    scenario = {
        "partition": "lab",
        "hear": [finger.channels for finger in FINGERS],
        "wait_for": 2 * len(expected),
        "publish": published(60),
    }
    file = tmp_path / "scenario.json"
    file.write_text(json.dumps(scenario))
    program = subprocess.Popen([*command, endpoint, file], stdout=subprocess.PIPE, text=True)
    try:
        # It listens a moment after its start.
        with running(predictor, endpoint, timeout=60.0) as bridge:
            told, _ = program.communicate(timeout=120)
            assert (bridge.refused, bridge.dropped) == (0, 0)
    finally:
        program.kill()
    assert program.wait() == 0
    heard = json.loads(told)
    assert heard["more"] == 0
    assert {one["type"] for one in heard["heard"]} == {CHANNELS}
    for place, finger in enumerate(FINGERS):
        own = [one for one in heard["heard"] if one["topic"] == finger.channels]
        np.testing.assert_allclose([one["data"] for one in own], np.array(expected)[:, place], atol=1e-3)
        assert [one["stamp"] for one in own][:3] == [[3, 0], [3, 10_000_000], [3, 20_000_000]]
    # A finger that is pressed and one that is not differ.
    assert np.abs(np.diff(expected[-1], axis=0)).max() > 1.0
    token = [f"{parts[5]} {parts[9]} {parts[10]}" for parts in (one.split("/") for one in heard["tokens"])]
    assert sorted(token) == sorted(
        [
            "MP %ff%tactile gz.msgs.Float_V",
            "MP %th%tactile gz.msgs.Float_V",
            "MS %world%w%clock gz.msgs.Clock",
            "MS %world%w%dynamic_pose%info gz.msgs.Pose_V",
            "MS %world%w%model%hand%link%ff_tip%sensor%touch%contact gz.msgs.Contacts",
            "MS %world%w%model%hand%link%th_tip%sensor%touch%contact gz.msgs.Contacts",
        ]
    )
    assert {one.split("/")[1] for one in heard["tokens"]} == {"%lab"}


def test_the_command_bridges_until_it_is_interrupted(
    predictor: Predictor, endpoint: str, command: list[str], tmp_path: Path
) -> None:
    expected = by_hand(predictor, 20)
    file = tmp_path / "scenario.json"
    file.write_text(
        json.dumps(
            {
                "partition": "lab",
                "hear": [FINGERS[0].channels],
                "wait_for": len(expected),
                "publish": published(20),
            }
        )
    )
    world = subprocess.Popen([*command, endpoint, file], stdout=subprocess.PIPE, text=True)
    try:
        host, _, port = endpoint.removeprefix("tcp/").partition(":")
        until(lambda: listens(host, int(port)))
        options = ["--world", "w", "--partition", "lab", "--router", endpoint]
        for name in ("ff", "th"):
            options += ["--finger", f"{name}=hand/{name}_tip/touch"]
        bridge = subprocess.Popen(
            [sys.executable, "-m", "taxel", "gazebo", *options], stderr=subprocess.PIPE, text=True
        )
        try:
            heard = json.loads(world.communicate(timeout=120)[0])["heard"]
        finally:
            interrupt(bridge.pid)
            said = bridge.communicate(timeout=60)[1]
    finally:
        world.kill()
    np.testing.assert_allclose([one["data"] for one in heard], np.array(expected)[:, 0], atol=1e-3)
    assert bridge.returncode == 130
    assert f"ff: {FF_TOPIC} gives /ff/tactile" in said


def test_the_strict_command_ends_at_the_first_input_that_looks_wrong(
    peer: zenoh.Session, endpoint: str, gz: Json
) -> None:
    options = ["--world", "w", "--partition", "lab", "--router", endpoint, "--strict"]
    for name in ("ff", "th"):
        options += ["--finger", f"{name}=hand/{name}_tip/touch"]
    with subprocess.Popen(
        [sys.executable, "-m", "taxel", "gazebo", *options], stderr=subprocess.PIPE, text=True
    ) as bridge:
        try:
            world = Publishing(peer, gz)
            for message in published(10)[:-1]:
                world.send(message)
            far = json.loads(json.dumps(TOUCHING))
            far["contact"][0]["position"][0]["x"] = 1.9
            world.send({"topic": FF_TOPIC, "type": CONTACTS, "message": far})
            for step in range(11, 22):
                world.send({"topic": FF_TOPIC, "type": CONTACTS, "message": far})
                world.send({"topic": CLOCK_TOPIC, "type": CLOCK, "message": clock(step)})
            _, said = bridge.communicate(timeout=60)
        finally:
            bridge.kill()
    assert "error: contacts are more than 4 mm off the skin" in said
    assert "Traceback" not in said
    assert bridge.returncode == 1


def interrupt(process: int) -> None:
    """Ctrl-C as the kernel may give it: to a thread of zenoh, which does not wake Python's."""
    threads = sorted(int(task.name) for task in Path(f"/proc/{process}/task").glob("*"))
    if not threads:
        os.kill(process, signal.SIGINT)
    elif ctypes.CDLL(None).tgkill(process, threads[-1], signal.SIGINT):
        os.kill(process, signal.SIGKILL)
        pytest.fail("no signal could be sent")


class Publishing:
    """Publishes as Gazebo does, in any partition, once the bridge is there."""

    def __init__(self, session: zenoh.Session, gz: Json) -> None:
        self._session, self._gz = session, gz
        # The clock is what a bridge subscribes to last.
        token = "@gz/%lab/*/*/*/MS/%/%/%/%world%w%clock/**"
        until(lambda: any(reply.ok for reply in session.liveliness().get(token)))

    def send(self, message: Json, partition: str = "lab", world: str = "w") -> None:
        payload = json_format.ParseDict(message["message"], self._gz[message["type"]]()).SerializeToString()
        topic = message["topic"].replace("/world/w/", f"/world/{world}/")
        self.raw(f"@/{partition}@{topic}", payload, message["type"])

    def raw(self, key: str, payload: bytes, attachment: str | None) -> None:
        self._session.put(key, payload, attachment=attachment)


def collected(predictions: "SimpleQueue[Prediction]", count: int) -> list[Any]:
    return [predictions.get(timeout=60).channels for _ in range(count)]


def test_other_partitions_and_worlds_are_kept_apart(
    predictor: Predictor, peer: zenoh.Session, endpoint: str, gz: Json
) -> None:
    predictions: SimpleQueue[Prediction] = SimpleQueue()
    expected = by_hand(predictor, 40)
    with running(predictor, endpoint, predictions.put):
        world = Publishing(peer, gz)
        for number, message in enumerate(published(40)):
            # Another clock and other contacts would give other channels.
            world.send(
                {"topic": CLOCK_TOPIC, "type": CLOCK, "message": clock(7 * number)}, partition="home"
            )
            world.send({"topic": CLOCK_TOPIC, "type": CLOCK, "message": clock(7 * number)}, world="v")
            world.send({"topic": FF_TOPIC, "type": CONTACTS, "message": TOUCHING}, partition="home")
            world.send({"topic": FF_TOPIC, "type": CONTACTS, "message": TOUCHING}, world="v")
            world.send(message)
        np.testing.assert_allclose(collected(predictions, len(expected)), expected, atol=1e-3)
        assert predictions.empty()


def interfered(
    predictor: Predictor,
    peer: zenoh.Session,
    endpoint: str,
    gz: Json,
    samples: list[tuple[str, bytes, str | None]],
) -> int:
    """A world with these samples beside its own still gives the right channels; how many were refused."""
    predictions: SimpleQueue[Prediction] = SimpleQueue()
    expected = by_hand(predictor, 40)
    with running(predictor, endpoint, predictions.put) as bridge:
        world = Publishing(peer, gz)
        for number, message in enumerate(published(40)):
            world.send(message)
            for sample in samples if number >= 40 else ():
                world.raw(*sample)
        np.testing.assert_allclose(collected(predictions, len(expected)), expected, atol=1e-3)
        return bridge.refused


def test_bytes_that_are_no_message_are_refused_by_name_and_others_go_on(
    predictor: Predictor, peer: zenoh.Session, endpoint: str, gz: Json
) -> None:
    # The thumb, which nothing touches, has contacts that are none; of poses the last good ones stay.
    topics = {FINGERS[1].contacts: CONTACTS, CLOCK_TOPIC: CLOCK, POSE_TOPIC: POSES}
    samples = [(f"@/lab@{topic}", b"nonsense", kind) for topic, kind in topics.items()]
    with pytest.warns(InputWarning) as told:
        refused = interfered(predictor, peer, endpoint, gz, samples)
    assert refused > 3
    expected = {f"{topic}: bytes that are no {kind}" for topic, kind in topics.items()}
    assert {str(one.message) for one in told} == expected


def test_messages_of_another_type_or_of_none_are_ignored_and_told(
    predictor: Predictor, peer: zenoh.Session, endpoint: str, gz: Json
) -> None:
    later = json_format.ParseDict(clock(99_999), gz[CLOCK]()).SerializeToString()
    types = {
        "gz.msgs.String": "gz.msgs.String",
        "gz.msgs.Clock2": "gz.msgs.Clock2",
        None: "untyped messages",
    }
    samples = [(f"@/lab@{CLOCK_TOPIC}", later, attachment) for attachment in types]
    with pytest.warns(InputWarning) as told:
        refused = interfered(predictor, peer, endpoint, gz, samples)
    assert refused == 0
    expected = {f"{CLOCK_TOPIC} carries {name}: expected gz.msgs.Clock" for name in types.values()}
    assert {str(one.message) for one in told} == expected


def test_too_many_messages_are_dropped_and_told(
    predictor: Predictor, peer: zenoh.Session, endpoint: str, gz: Json, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zenoh_bridge, "_WAITING_MESSAGES", 3)
    with ZenohBridge(predictor, SETTINGS, partition="lab", router=endpoint) as bridge:
        world = Publishing(peer, gz)
        for message in published(10)[:8]:
            world.send(message)
        until(lambda: bridge.dropped == 5)
        threading.Timer(0.2, bridge.stop).start()
        with pytest.warns(InputWarning, match="messages were dropped"):
            bridge.run()


def test_a_bridge_that_leaves_takes_its_tokens_along(
    predictor: Predictor, peer: zenoh.Session, endpoint: str
) -> None:
    kinds: SimpleQueue[zenoh.SampleKind] = SimpleQueue()
    watched = peer.liveliness().declare_subscriber(
        "@gz/%lab/*/*/*/MP/**", Callback(lambda sample: kinds.put(sample.kind), indirect=False)
    )
    ZenohBridge(predictor, SETTINGS, partition="lab", router=endpoint).close()
    assert [kinds.get(timeout=60) for _ in range(4)] == [zenoh.SampleKind.PUT] * 2 + [
        zenoh.SampleKind.DELETE
    ] * 2
    watched.undeclare()  # type: ignore[no-untyped-call]


def test_a_silent_network_says_what_must_fit(
    predictor: Predictor, peer: zenoh.Session, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zenoh_bridge, "_SILENCE_S", 0.01)
    with ZenohBridge(predictor, SETTINGS, partition="lab", router=endpoint) as bridge:
        threading.Timer(0.2, bridge.stop).start()
        with pytest.warns(
            InputWarning, match="nothing on @/lab@/world/w/clock: .*'w' in the partition 'lab'"
        ):
            bridge.run()


def test_without_a_router_it_says_so(predictor: Predictor, endpoint: str) -> None:
    with pytest.raises(Unavailable, match=f"no way to {endpoint} within 0.3 s into the network of Gazebo"):
        ZenohBridge(predictor, SETTINGS, router=endpoint, timeout=0.3)

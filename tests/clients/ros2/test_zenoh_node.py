"""`taxel ros2` on a real zenoh network, held against a bare session that does what the wire's rules say."""

import json
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
import zenoh
from zenoh.handlers import Callback

from taxel.errors import InvalidArgument, Unavailable
from taxel.predictor import Predictor
from taxel.ros2.cdr import CdrTypes, decode, encode, type_hash
from taxel.ros2.messages import BIOTAC_ALL, CHANNEL_ARRAY, DIAGNOSTICS, POINT, WRENCH, header_of
from taxel.ros2.rmw_zenoh import Topic, announced, gid_of
from taxel.ros2.settings import NodeSettings
from taxel.ros2.zenoh_node import ZenohNode

PYZEROS = Path(sys.prefix) / "ros2" / "bin" / "python"
TYPES = CdrTypes()
START = 1_700_000_000_000_000_000
TICK = 10_000_000


def key(topic: str, name: str) -> str:
    package, kind, short = name.split("/")
    full = topic.removeprefix("/") if topic.startswith("/") else f"rh/{topic}"
    return f"3/{full}/{package}::{kind}::dds_::{short}_/{type_hash(name)}"


def vector(name: str, values: tuple[float, float, float]) -> Any:
    return TYPES.type_of(f"geometry_msgs/msg/{name}")(**dict(zip("xyz", values, strict=True)))


def wrench(stamp_ns: int, force: tuple[float, float, float], frame: str) -> bytes:
    both = TYPES.type_of("geometry_msgs/msg/Wrench")(
        force=vector("Vector3", force), torque=vector("Vector3", (0.0, 0.0, 0.0))
    )
    return encode(TYPES.type_of(WRENCH)(header=header_of(TYPES, stamp_ns, frame), wrench=both), WRENCH)


def point(stamp_ns: int, place: tuple[float, float, float], frame: str) -> bytes:
    header = header_of(TYPES, stamp_ns, frame)
    return encode(TYPES.type_of(POINT)(header=header, point=vector("Point", place)), POINT)


@pytest.fixture
def node(router: str, predictor: Predictor) -> Iterator[ZenohNode]:
    settings = NodeSettings(("ff", "th"), frame_id="rh_{finger}tip")
    with ZenohNode(predictor, settings, router=router, domain=3, namespace="/rh") as running:
        thread = threading.Thread(target=running.run)
        thread.start()
        yield running
        running.stop()
        thread.join(60)
        assert not thread.is_alive()


def listen(session: zenoh.Session, topic: str) -> "SimpleQueue[zenoh.Sample]":
    samples: SimpleQueue[zenoh.Sample] = SimpleQueue()
    subscriber = session.declare_subscriber(topic, Callback(samples.put, indirect=False))
    _KEPT.append(subscriber)
    return samples


_KEPT: list[Any] = []


def sender(session: zenoh.Session, topic: str, name: str) -> Callable[[bytes], None]:
    publisher = session.declare_publisher(key(topic, name))
    while not publisher.matching_status:
        time.sleep(0.01)
    return publisher.put


def statuses(message: Any) -> dict[str, Any]:
    return {status.name: status for status in message.status}


def diagnosed(diagnostics: "SimpleQueue[zenoh.Sample]", name: str, text: str) -> Any:
    """The first status of this name whose message has this text."""
    for _ in range(60):
        message = decode(diagnostics.get(timeout=60).payload.to_bytes(), DIAGNOSTICS)
        status = statuses(message)[name]
        if text in status.message:
            return status
    pytest.fail(f"{name} never said {text!r}: the last was {status.message!r}")


TOKENS = 9
"""Of a node with two fingers: its own, four publishers and four subscribers."""


def tokens(session: zenoh.Session) -> list[str]:
    """All tokens of the domain, once a node's have come: a router passes them on one after another."""
    came: SimpleQueue[zenoh.Sample] = SimpleQueue()
    every = session.liveliness()
    watched = every.declare_subscriber("@ros2_lv/3/**", Callback(came.put, indirect=False), history=True)
    keys: set[str] = set()
    while len(keys) < TOKENS:
        keys.add(str(came.get(timeout=60).key_expr))
    watched.undeclare()  # type: ignore[no-untyped-call]
    replies = every.get("@ros2_lv/3/**")
    return sorted(keys.union(str(reply.ok.key_expr) for reply in replies if reply.ok is not None))


def test_a_node_is_found_by_its_tokens(node: ZenohNode, session: zenoh.Session) -> None:
    found = [token.split("/") for token in tokens(session)]
    assert {tuple(parts[6:9]) for parts in found} == {("%", "%rh", "taxel")}
    assert len({(parts[3], parts[4]) for parts in found}) == len(found)
    entities = {(parts[5], *parts[9:11], *parts[12:]) for parts in found if parts[5] != "NN"}
    reliable, lossy = "::,10:,:,:,,", "2::,50:,:,:,,"
    assert entities == {
        ("MP", "%rh%ff%tactile", "std_msgs::msg::dds_::Float32MultiArray_", reliable),
        ("MP", "%rh%th%tactile", "std_msgs::msg::dds_::Float32MultiArray_", reliable),
        ("MP", "%rh%tactile", "sr_robot_msgs::msg::dds_::BiotacAll_", reliable),
        ("MP", "%diagnostics", "diagnostic_msgs::msg::dds_::DiagnosticArray_", reliable),
        ("MS", "%rh%ff%wrench", "geometry_msgs::msg::dds_::WrenchStamped_", lossy),
        ("MS", "%rh%ff%point", "geometry_msgs::msg::dds_::PointStamped_", lossy),
        ("MS", "%rh%th%wrench", "geometry_msgs::msg::dds_::WrenchStamped_", lossy),
        ("MS", "%rh%th%point", "geometry_msgs::msg::dds_::PointStamped_", lossy),
    }


def test_a_node_that_leaves_takes_its_tokens_along(
    router: str, session: zenoh.Session, predictor: Predictor
) -> None:
    gone: SimpleQueue[zenoh.Sample] = SimpleQueue()
    watched = session.liveliness().declare_subscriber(
        "@ros2_lv/3/*/*/*/NN/**", Callback(gone.put, indirect=False)
    )
    ZenohNode(predictor, NodeSettings(("ff",)), router=router, domain=3).close()
    assert [gone.get(timeout=60).kind for _ in range(2)] == [zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE]
    watched.undeclare()  # type: ignore[no-untyped-call]


def test_a_node_finds_a_router_that_began_again(
    lost_router: tuple[str, Callable[[], zenoh.Session]], predictor: Predictor
) -> None:
    router, begin_again = lost_router
    with ZenohNode(predictor, NodeSettings(("ff",)), router=router, domain=3):
        came: SimpleQueue[zenoh.Sample] = SimpleQueue()
        watched = (
            begin_again()
            .liveliness()
            .declare_subscriber("@ros2_lv/3/*/*/*/NN/**", Callback(came.put, indirect=False), history=True)
        )
        assert came.get(timeout=60).kind == zenoh.SampleKind.PUT
        watched.undeclare()  # type: ignore[no-untyped-call]


def test_contacts_become_channels(node: ZenohNode, session: zenoh.Session, predictor: Predictor) -> None:
    arrays = listen(session, key("ff/tactile", CHANNEL_ARRAY))
    hands = listen(session, key("tactile", BIOTAC_ALL))
    send_wrench, send_point = sender(session, "ff/wrench", WRENCH), sender(session, "ff/point", POINT)
    stream = predictor.stream()
    expected: list[tuple[int, Any]] = []
    for step in range(50):
        place, force = (-0.001 * (step % 5), 0.0, -0.007), (0.0, 0.2, 0.02 * step)
        send_point(point(START + step * TICK, place, "rh_fftip"))
        send_wrench(wrench(START + step * TICK, force, "rh_fftip"))
        # What touches with no force is nowhere new.
        at = place if any(force) else (0.0, 0.0, -0.007)
        for window in stream.push_ns(START + step * TICK, at, force):
            expected.append((window.time_ns, predictor.predict(window.values)[0]))
    token = next(token for token in tokens(session) if "/%rh%ff%tactile/" in token)
    for number, (_, channels) in enumerate(expected, start=1):
        sample = arrays.get(timeout=60)
        np.testing.assert_array_equal(decode(sample.payload.to_bytes(), CHANNEL_ARRAY).data, channels)
        assert sample.attachment is not None
        sequence, time_ns, size, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
        assert (sequence, size, gid) == (number, 16, gid_of(token))
        assert abs(time_ns - time.time_ns()) < 3_600 * 10**9
    for stamp_ns, channels in expected:
        hand = decode(hands.get(timeout=60).payload.to_bytes(), BIOTAC_ALL)
        assert hand.header.stamp.sec * 10**9 + hand.header.stamp.nanosec == stamp_ns
        electrodes = [tactile.electrodes.tolist() for tactile in hand.tactiles]
        assert electrodes == [np.rint(channels[2:]).tolist(), [], [], [], []]


def test_what_is_wrong_is_told_in_diagnostics(node: ZenohNode, session: zenoh.Session) -> None:
    diagnostics = listen(session, key("/diagnostics", DIAGNOSTICS))
    send = sender(session, "ff/wrench", WRENCH)
    send(wrench(START, (0.0, 0.0, 0.0), "world"))
    assert diagnosed(diagnostics, "taxel: ff", "frame 'world': expected 'rh_fftip'").level == 2
    send(b"\x00\x01\x00\x00nonsense")
    assert diagnosed(diagnostics, "taxel: ff", "ff/wrench: 12 bytes are no geometry_msgs").level == 2
    assert diagnosed(diagnostics, "taxel: th", "no contact yet").level == 3


@pytest.mark.filterwarnings("ignore::taxel.errors.InputWarning")
@pytest.mark.parametrize(
    ("place", "force", "text"),
    [
        ((0.0, 0.0, -0.007), (0.0, 0.0, -1.0), "pull at the skin: expected the force on the finger"),
        ((0.0, 0.0, -0.007), (0.0, 0.0, 150.0), "forces up to 150 look like grams: expected newtons"),
        ((0.0, 0.0, -7.0), (0.0, 0.0, 1.0), "touched places look like millimetres, as 7: expected metres"),
    ],
)
def test_contacts_that_look_wrong_are_told_in_diagnostics(
    node: ZenohNode,
    session: zenoh.Session,
    place: tuple[float, float, float],
    force: tuple[float, float, float],
    text: str,
) -> None:
    diagnostics = listen(session, key("/diagnostics", DIAGNOSTICS))
    send_wrench, send_point = sender(session, "ff/wrench", WRENCH), sender(session, "ff/point", POINT)
    for step in range(120):
        send_point(point(START + step * TICK, place, "rh_fftip"))
        send_wrench(wrench(START + step * TICK, force, "rh_fftip"))
    diagnosed(diagnostics, "taxel: ff", text)
    # Nothing comes any more, and yet that is not forgotten.
    for _ in range(2):
        status = statuses(decode(diagnostics.get(timeout=60).payload.to_bytes(), DIAGNOSTICS))["taxel: ff"]
        assert text in status.message
        assert status.level in (1, 3)


def test_the_strict_command_ends_at_the_first_contact_that_looks_wrong(
    router: str, session: zenoh.Session
) -> None:
    diagnostics = listen(session, key("/diagnostics", DIAGNOSTICS))
    options = ["--router", router, "--domain", "3", "--namespace", "/rh", "--fingers", "ff", "--strict"]
    with subprocess.Popen(
        [sys.executable, "-m", "taxel", "ros2", *options], stderr=subprocess.PIPE, text=True
    ) as command:
        try:
            send_wrench, send_point = (
                sender(session, "ff/wrench", WRENCH),
                sender(session, "ff/point", POINT),
            )
            for step in range(6000):
                if command.poll() is not None:
                    break
                send_point(point(START + step * TICK, (0.0, 0.0, -0.007), "ff_biotac"))
                send_wrench(wrench(START + step * TICK, (0.0, 0.0, 150.0), "ff_biotac"))
                time.sleep(0.01)
            _, said = command.communicate(timeout=60)
        finally:
            command.kill()
    text = "finger ff, xgb-causal/1: forces up to 150 look like grams: expected newtons"
    assert f"error: {text}" in said
    assert "Traceback" not in said
    assert command.returncode == 1
    assert diagnosed(diagnostics, "taxel: ff", text).level == 2


def test_a_publisher_of_another_type_is_told(node: ZenohNode, session: zenoh.Session) -> None:
    diagnostics = listen(session, key("/diagnostics", DIAGNOSTICS))
    token = session.liveliness().declare_token(
        "@ros2_lv/3/abcd/0/5/MP/%/%/driver/%rh%th%wrench/geometry_msgs::msg::dds_::WrenchStamped_/"
        "TypeHashNotSupported/::,10:,:,:,,"
    )
    status = diagnosed(diagnostics, "taxel: th", "is published as")
    assert "geometry_msgs/msg/WrenchStamped TypeHashNotSupported: expected geometry_msgs" in status.message
    token.undeclare()  # type: ignore[no-untyped-call]
    while "published as" in diagnosed(diagnostics, "taxel: th", "no contact yet").message:
        pass


def test_another_authors_client_speaks_with_it_both_ways(router: str, predictor: Predictor) -> None:
    if (
        not PYZEROS.exists()
        or subprocess.run([PYZEROS, "-c", "import pyzeros"], capture_output=True).returncode
    ):
        pytest.skip("pyzeros is not installed: `make test` installs it")
    stream = predictor.stream()
    expected: list[Any] = []
    for step in range(60):
        place, force = (-0.001 * (step % 5), 0.0, -0.007), (0.0, 0.2, 0.02 * step)
        for window in stream.push_ns(START + step * TICK, place, force):
            expected.append(predictor.predict(window.values)[0])
    with ZenohNode(predictor, NodeSettings(("ff",)), router=router, domain=3, namespace="/rh") as node:
        thread = threading.Thread(target=node.run)
        thread.start()
        program = Path(__file__).parent / "ros_programs" / "pyzeros_hand.py"
        command = [PYZEROS, program, router, "60", str(len(expected))]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        finally:
            node.stop()
            thread.join(60)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    np.testing.assert_array_equal(told["arrays"], expected)
    # Its token and its GID are the ones that we would give.
    assert announced(told["token"]) == Topic("/rh/ff/wrench", WRENCH, type_hash(WRENCH))
    assert gid_of(told["token"]).hex() == told["gid"]


def test_without_a_router_it_says_what_to_start(predictor: Predictor) -> None:
    with pytest.raises(Unavailable, match="expected `ros2 run rmw_zenoh_cpp rmw_zenohd`"):
        ZenohNode(predictor, NodeSettings(), router="tcp/127.0.0.1:9", timeout=0.3)
    with pytest.raises(InvalidArgument, match="is a URL"):
        ZenohNode(predictor, NodeSettings(), router="http://localhost:7447")

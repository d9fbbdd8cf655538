"""Recordings in bags of ROS: written and read back, interpolated, ambiguous, and damaged."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from typer.testing import CliRunner

from taxel.channels import CHANNELS
from taxel.commands.cli import build
from taxel.errors import RecordingError, SettingsError
from taxel.ros2.cdr import CdrTypes, encode, typestore
from taxel.ros2.messages import (
    BIOTAC,
    BIOTAC_ALL,
    CONTACT,
    DEFINITIONS,
    POINT,
    WRENCH,
    biotac_all,
    header_of,
)
from taxel_models.recordings import Recording, read_recording, write_ros_bag
from taxel_models.recordings.recording import AUXILIARY

# Places are made up to be recognised: they lie on no skin.
pytestmark = pytest.mark.filterwarnings("ignore::taxel.errors.InputWarning")

TYPES = CdrTypes()
START = 1_700_000_000_000_000_000
TICK = 10_000_000
Message = tuple[str, str, int, Any]


def made(rows: int = 30, **covariates: Any) -> Recording:
    rng = np.random.default_rng(5)
    time_ns = START + np.cumsum(rng.integers(9_000_000, 11_000_000, rows))
    return Recording.of(
        time_ns,
        rng.uniform(-0.01, 0.01, (rows, 3)),
        rng.normal(0.0, 2.0, (rows, 3)),
        rng.integers(0, 4096, (rows, len(CHANNELS))),
        {name: rng.integers(-5, 4096, rows) for name in AUXILIARY},
        covariates,
    )


def vector(name: str, values: Iterable[float]) -> Any:
    return TYPES.type_of(f"geometry_msgs/msg/{name}")(*map(float, values))


def wrench(
    time_ns: int, force: Iterable[float], topic: str = "/rh/ff/wrench", frame: str = "tip"
) -> Message:
    both = TYPES.type_of("geometry_msgs/msg/Wrench")(vector("Vector3", force), vector("Vector3", (0, 0, 0)))
    return topic, WRENCH, time_ns, TYPES.type_of(WRENCH)(header_of(TYPES, time_ns, frame), both)


def point(time_ns: int, place: Iterable[float], topic: str = "/rh/ff/point", frame: str = "tip") -> Message:
    return (
        topic,
        POINT,
        time_ns,
        TYPES.type_of(POINT)(header_of(TYPES, time_ns, frame), vector("Point", place)),
    )


def hand(time_ns: int, value: float = 100.0, finger: str = "ff", topic: str = "/rh/tactile") -> Message:
    channels = np.full(len(CHANNELS), value, np.float32)
    return topic, BIOTAC_ALL, time_ns, biotac_all(TYPES, time_ns, {finger: channels})


def write(path: Path, messages: Iterable[Message]) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        connections: dict[str, Any] = {}
        for topic, kind, time_ns, message in sorted(messages, key=lambda one: one[2]):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=typestore())
            bag.write(connections[topic], time_ns, encode(message, kind))
    return path


def grid(*kinds: Callable[[int], Message], ticks: int = 10) -> list[Message]:
    return [kind(START + tick * TICK) for tick in range(ticks) for kind in kinds]


@pytest.mark.parametrize("name", ["run.mcap", "run"])
@pytest.mark.parametrize("finger", ["ff", "th"])
def test_what_is_written_is_read_back(tmp_path: Path, name: str, finger: str) -> None:
    recording = made(material=np.full(30, 3.0), velocity_x=np.linspace(-1, 1, 30))
    write_ros_bag(recording, tmp_path / name, finger)
    read = read_recording(tmp_path / name)
    assert (read.name, read.format, read.dropped) == ("run", "ros_bag", {})
    assert len(read.sha256) == 64
    np.testing.assert_array_equal(read.samples.time_ns, recording.samples.time_ns)
    np.testing.assert_array_equal(read.samples.position, recording.samples.position)
    np.testing.assert_array_equal(read.samples.force, recording.samples.force)
    np.testing.assert_array_equal(read.channels, recording.channels)
    for columns, expected in (
        (read.auxiliary, recording.auxiliary),
        (read.covariates, recording.covariates),
    ):
        assert set(columns) == set(expected)
        for each, values in expected.items():
            np.testing.assert_array_equal(columns[each], values)
    files = [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*"))]
    assert files == ([name] if name == "run.mcap" else ["run", "run/metadata.yaml", "run/run.db3"])


def test_contacts_of_another_clock_are_interpolated(tmp_path: Path) -> None:
    messages = grid(hand)
    for tick in range(-1, 12):
        time_ns = START + tick * TICK + 3_000_000
        messages += [wrench(time_ns, (tick, 0, 2 * tick)), point(time_ns, (0, 0.001 * tick, 0))]
    read = read_recording(write(tmp_path / "bag", messages))
    ticks = np.arange(10) - 0.3
    np.testing.assert_allclose(read.samples.force, np.outer(ticks, (1, 0, 2)), atol=1e-9)
    np.testing.assert_allclose(read.samples.position, np.outer(ticks, (0, 0.001, 0)), atol=1e-12)


def test_rows_without_contacts_or_electrodes_are_dropped_and_counted(tmp_path: Path) -> None:
    messages = [hand(START + tick * TICK, finger="mf" if tick == 20 else "ff") for tick in range(60)]
    for tick in range(10, 50):
        pressed = 1.0 if tick < 35 else 0.0
        messages.append(wrench(START + tick * TICK, (0, 0, pressed)))
        # Points stop for 8 ticks in which there is force, and again while nothing touches.
        if not 24 < tick < 32 and not 37 < tick < 49:
            messages.append(point(START + tick * TICK, (0, 0, -0.007)))
    read = read_recording(write(tmp_path / "bag", messages))
    assert read.dropped == {
        "before or after the contacts": 20,
        "no electrodes of this finger": 1,
        "no contact within 50 ms": 7,
    }
    assert len(read) == 32


def test_a_tactile_contact_has_both_place_and_force(tmp_path: Path) -> None:
    def contact(time_ns: int) -> Message:
        force = TYPES.type_of("geometry_msgs/msg/Wrench")(
            vector("Vector3", (1, 2, 3)), vector("Vector3", (0, 0, 0))
        )
        message = TYPES.type_of(CONTACT)(
            header_of(TYPES, time_ns, "tip"),
            "ff",
            vector("Point", (4, 5, 6)),
            vector("Vector3", (0, 0, 1)),
            force,
        )
        return "/ff/contact", CONTACT, time_ns, message

    read = read_recording(write(tmp_path / "bag", grid(hand, contact)))
    assert read.samples.position[3].tolist() == [4.0, 5.0, 6.0]
    assert read.samples.force[3].tolist() == [1.0, 2.0, 3.0]


def test_a_bag_of_ros_1_is_read(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    for name, definition in DEFINITIONS.items():
        store.register(get_types_from_msg(definition, name))

    def of(name: str, *values: Any) -> Any:
        return store.types[name](*values)

    def header(time_ns: int, frame: str) -> Any:
        stamp = of("builtin_interfaces/msg/Time", time_ns // 10**9, time_ns % 10**9)
        return of("std_msgs/msg/Header", 0, stamp, frame)

    nothing = of("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    below = of("geometry_msgs/msg/Point", 0.0, 0.0, -0.007)
    with Rosbag1Writer(tmp_path / "run.bag") as bag:
        topics = {BIOTAC_ALL: "/rh/tactile", WRENCH: "/ff/wrench", POINT: "/ff/point"}
        connections = {
            kind: bag.add_connection(name, kind, typestore=store) for kind, name in topics.items()
        }
        for tick in range(9):
            time_ns = START + tick * TICK
            force = of(
                "geometry_msgs/msg/Wrench", of("geometry_msgs/msg/Vector3", 0.0, 0.0, float(tick)), nothing
            )
            finger = of(BIOTAC, tick, 1, 2, 3, 4, np.arange(19, dtype=np.int16))
            for kind, message in {
                BIOTAC_ALL: of(BIOTAC_ALL, header(time_ns, ""), [finger] * 5),
                WRENCH: of(WRENCH, header(time_ns, "tip"), force),
                POINT: of(POINT, header(time_ns, "tip"), below),
            }.items():
                bag.write(connections[kind], time_ns, store.serialize_ros1(message, kind))
    read = read_recording(tmp_path / "run.bag")
    assert read.samples.force[:, 2].tolist() == list(range(9))
    assert read.channels[5].tolist() == [5, 2, *range(19)]
    assert {name: column[0] for name, column in read.auxiliary.items()} == {"pac1": 1, "tac": 3, "tdc": 4}


def push(time_ns: int) -> Message:
    return wrench(time_ns, (0, 0, 1))


def place(time_ns: int) -> Message:
    return point(time_ns, (0, 0, -0.007))


@pytest.mark.parametrize(
    ("messages", "text"),
    [
        (grid(push, place), "0 topics of sr_robot_msgs/msg/BiotacAll; expected one"),
        (grid(hand, push), "0 topics of geometry_msgs/msg/PointStamped of finger 'ff'; expected one"),
        (grid(hand, place), "no topic of contacts that names a finger; expected --finger"),
        (grid(hand, push, place, lambda t: wrench(t, (0, 0, 1), "/ff/other")), "2 topics of geometry_msgs"),
        (
            grid(hand, push, place, lambda t: wrench(t, (0, 0, 1), "/th/wrench")),
            "contacts of ff, th; expected --finger",
        ),
        (
            grid(hand, push, lambda t: point(t, (0, 0, 0), frame="world")),
            "/rh/ff/point in 'world'; expected one frame",
        ),
        (grid(hand, push, lambda t: point(t, (0, 0, np.nan))), "/rh/ff/point, message 1: [0.0, 0.0, nan]"),
        (grid(push, place, lambda t: hand(t, finger="lf")), "10 no electrodes of this finger"),
        (
            grid(hand, place, lambda t: wrench(max(t - 3 * TICK, START), (0, 0, 1))),
            "expected time to increase",
        ),
    ],
)
def test_what_cannot_be_a_recording_is_refused(tmp_path: Path, messages: list[Message], text: str) -> None:
    path = write(tmp_path / "bag", messages)
    with pytest.raises(RecordingError, match=r"expected|none of") as caught:
        read_recording(path)
    assert text in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_bag_of_several_fingers_is_read_one_by_one(tmp_path: Path) -> None:
    def other(time_ns: int) -> Message:
        return wrench(time_ns, (0, 0, 2), "/rh/th/wrench")

    def below(time_ns: int) -> Message:
        return point(time_ns, (0.001, 0, 0), "/rh/th/point")

    path = write(tmp_path / "bag", grid(lambda t: hand(t, finger="th"), push, place, other, below))
    read = read_recording(path, finger="th")
    assert read.samples.force[0].tolist() == [0.0, 0.0, 2.0]
    with pytest.raises(RecordingError, match="10 no electrodes of this finger"):
        read_recording(path, finger="ff")


def test_a_damaged_bag_is_refused_or_read(tmp_path: Path) -> None:
    write_ros_bag(made(), tmp_path / "run.mcap")
    write_ros_bag(made(), tmp_path / "run")
    (file,) = (tmp_path / "run").glob("*.db3")
    damaged = tmp_path / "damaged.mcap"
    rng = np.random.default_rng(2)
    for source, target in ((tmp_path / "run.mcap", damaged), (file, file)):
        whole, read = source.read_bytes(), 0
        for cut in np.linspace(0, len(whole) - 1, 25).astype(int).tolist():
            target.write_bytes(whole[:cut])
            # The last bytes of a database may hold nothing: then all is there.
            with suppress(RecordingError):
                assert len(read_recording(target if target is damaged else tmp_path / "run")) == 30
                read += 1
        assert read <= 1
        refused = 0
        for _ in range(40):
            changed = bytearray(whole)
            for at in rng.integers(0, len(whole), 8):
                changed[at] ^= int(rng.integers(1, 256))
            target.write_bytes(changed)
            try:
                read_recording(target if target is damaged else tmp_path / "run")
            except RecordingError:
                refused += 1
        assert refused
    (tmp_path / "run" / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}")
    with pytest.raises(RecordingError, match="cannot be read"):
        read_recording(tmp_path / "run")


def test_what_messages_cannot_hold_is_refused(tmp_path: Path) -> None:
    whole = made()
    half = Recording(whole.samples, whole.channels + 0.5, whole.auxiliary)
    with pytest.raises(RecordingError, match=r"pac0 is \S+ in row 0; expected whole counts from 0 to 4095"):
        write_ros_bag(half, tmp_path / "half.mcap")
    with pytest.raises(SettingsError, match="covariate 'a b' cannot be part of a topic's name"):
        write_ros_bag(made(**{"a b": np.zeros(30)}), tmp_path / "named.mcap")
    with pytest.raises(RecordingError, match="has no rows"):
        write_ros_bag(whole.rows(slice(0, 0)), tmp_path / "empty.mcap")
    assert list(tmp_path.iterdir()) == []


def test_the_command_converts_there_and_back(tmp_path: Path) -> None:
    run = CliRunner().invoke
    write_ros_bag(made(), tmp_path / "a.mcap", "mf")
    for source, target in (("a.mcap", "b.csv"), ("b.csv", "c"), ("c", "d.csv")):
        done = run(build(), ["recording", str(tmp_path / source), "-o", str(tmp_path / target), "--json"])
        assert done.exit_code == 0, done.output
    assert (tmp_path / "b.csv").read_bytes() == (tmp_path / "d.csv").read_bytes()
    assert run(build(), ["recording", str(tmp_path / "c"), "--finger", "xf"]).exit_code == 2

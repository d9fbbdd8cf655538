"""The node in real ROS 2, from wheels, and our bytes and hashes against ROS's own."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import taxel
from taxel.ros2.cdr import CdrTypes, decode, encode, type_hash
from taxel.ros2.messages import (
    BIOTAC,
    BIOTAC_ALL,
    CHANNEL_ARRAY,
    CONTACT,
    DEFINITIONS,
    DIAGNOSTICS,
    POINT,
    WRENCH,
    Level,
    Status,
    biotac_all,
    channel_array,
    diagnostic_array,
    header_of,
)

PYTHON = Path(sys.prefix) / "ros2" / "bin" / "python"
PROGRAMS = Path(__file__).parent / "ros_programs"
LAUNCH = Path(__file__).parents[3] / "examples" / "ros2" / "fingertips.launch.xml"
TYPES = CdrTypes()
STEPS = 60


class Ros:
    """ROS's Python with messages of Shadow Robot and of Bielefeld."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = {
            **os.environ,
            "PYTHONPATH": str(folder),
            "AMENT_PREFIX_PATH": str(PYTHON.parents[1]),
            # A domain of its own, so that tests that run beside this one are not heard.
            "ROS_DOMAIN_ID": str(os.getpid() % 100 + 1),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(folder / "log"),
        }

    def start(self, *arguments: str | Path, **options: Any) -> "subprocess.Popen[str]":
        command = [str(PYTHON), *map(str, arguments)]
        return subprocess.Popen(command, env=self.environment, text=True, stdout=subprocess.PIPE, **options)

    def run(self, *arguments: str | Path, given: str = "") -> Any:
        with self.start(*arguments, stdin=subprocess.PIPE) as process:
            output, _ = process.communicate(given, timeout=300)
        assert process.returncode == 0
        return json.loads(output) if output else None


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Ros:
    if (
        not PYTHON.exists()
        or subprocess.run([PYTHON, "-c", "import rclpy"], capture_output=True).returncode
    ):
        pytest.skip(
            "rclpy is not installed: `make test` installs it on x86-64 Linux with Python 3.11 to 3.13"
        )
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed: ROS's messages are built with it")
    folder = tmp_path_factory.mktemp("ros")
    for name, definition in DEFINITIONS.items():
        package, kind, short = name.split("/")
        path = folder / "msg" / package / kind / f"{short}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(definition)
    made = Ros(folder)
    with made.start(PROGRAMS / "build_messages.py", folder) as process:
        log, _ = process.communicate(timeout=300)
    assert process.returncode == 0, log
    return made


def test_our_hashes_are_those_of_ross_generators(ros: Ros) -> None:
    hashes = json.loads((ros.folder / "hashes.json").read_text())
    share = PYTHON.parents[1] / "share"
    for name in (CHANNEL_ARRAY, WRENCH, POINT, DIAGNOSTICS):
        package, kind, short = name.split("/")
        described = json.loads((share / package / kind / f"{short}.json").read_text())
        hashes |= {one["type_name"]: one["hash_string"] for one in described["type_hashes"]}
    names = (BIOTAC, BIOTAC_ALL, CONTACT, CHANNEL_ARRAY, WRENCH, POINT, DIAGNOSTICS)
    assert {name: hashes[name] for name in names} == {name: type_hash(name) for name in names}


def messages() -> dict[str, Any]:
    header = header_of(TYPES, 1_700_000_000_123_456_789, "rh_fftip")

    def of(name: str, **fields: Any) -> Any:
        return TYPES.type_of(f"geometry_msgs/msg/{name}")(**fields)

    wrench = of(
        "Wrench", force=of("Vector3", x=0.5, y=-1.0, z=2.25), torque=of("Vector3", x=0.0, y=1e-3, z=0.0)
    )
    place = of("Point", x=-0.004, y=0.0, z=-0.007)
    channels = np.linspace(0, 4095, 21).astype(np.float32)
    return {
        WRENCH: of("WrenchStamped", header=header, wrench=wrench),
        POINT: of("PointStamped", header=header, point=place),
        CONTACT: TYPES.type_of(CONTACT)(
            header=header,
            name="ff",
            position=place,
            normal=of("Vector3", x=0.0, y=0.0, z=-1.0),
            wrench=wrench,
        ),
        CHANNEL_ARRAY: channel_array(TYPES, channels),
        BIOTAC_ALL: biotac_all(TYPES, 1_700_000_000_000_000_001, {"ff": channels, "th": channels[::-1]}),
        DIAGNOSTICS: diagnostic_array(
            TYPES, 7, [Status("taxel: ff", Level.STALE, "silent", {"a": "1", "bc": ""})]
        ),
    }


def plain(value: Any) -> Any:
    if is_dataclass(value):
        # Beside its fields, a class has the constants of its definition, and its own name.
        named = [field.name for field in fields(value) if field.name.islower() and field.name[0] != "_"]
        return {name: plain(getattr(value, name)) for name in named}
    if isinstance(value, str | int | float):
        return value
    return [plain(each) for each in (value.tolist() if isinstance(value, np.ndarray) else value)]


def test_ros_reads_what_we_write_and_we_read_what_ros_writes(ros: Ros) -> None:
    ours = {name: (message, encode(message, name)) for name, message in messages().items()}
    given = json.dumps({name: payload.hex() for name, (_, payload) in ours.items()})
    answers = ros.run(PROGRAMS / "serialize.py", given=given)
    for name, (read, written) in answers.items():
        message, payload = ours[name]
        assert read == plain(message)
        assert plain(decode(bytes.fromhex(written), name)) == read
        # Fast CDR leaves whatever was there in the bytes between fields; all others are ours.
        assert len(written) == 2 * len(payload)


def launched() -> list[str]:
    """The command of the launch file, as `ros2 launch` makes it: that program is not among the wheels."""
    tree = ElementTree.parse(LAUNCH)
    values = {each.attrib["name"]: each.attrib["default"] for each in tree.iter("arg")}
    (executable,) = tree.iter("executable")
    command = executable.attrib["cmd"]
    for name, value in values.items():
        command = command.replace(f"$(var {name})", value)
    return command.replace("$(dirname)", str(LAUNCH.parent)).split()


def test_a_node_of_ros_turns_contacts_into_channels(ros: Ros) -> None:
    """With the model for who names none: it answers without delay."""
    python, *arguments = launched()
    assert python == "python3"
    node = ros.start(*arguments)
    with node:
        try:
            told = ros.run(PROGRAMS / "hand.py", str(STEPS), "--ros-args", "-r", "__ns:=/rh")
        finally:
            node.terminate()
    expected = []
    with taxel.load() as models:
        predictor = models.predictor()
        assert predictor.window.delay_s == 0.0
        stream = predictor.stream()
        for step in range(STEPS):
            time_ns = 1_700_000_000_000_000_000 + step * 10_000_000
            place, force = (-0.001 * (step % 5), 0.0, -0.007), (0.0, 0.2, 0.02 * step)
            for window in stream.push_ns(time_ns, place, force):
                expected.append((window.time_ns, predictor.predict(window.values)[0]))
    np.testing.assert_array_equal(told["arrays"][-len(expected) :], [channels for _, channels in expected])
    nothing: list[int] = []
    assert [hand for hand in told["hands"] if hand[0] >= expected[0][0]] == [
        [time_ns, [np.rint(channels[2:]).tolist(), nothing, nothing, nothing, nothing]]
        for time_ns, channels in expected
    ]
    level, message = told["statuses"]["taxel: th"]
    assert level == Level.ERROR
    assert "frame 'world': expected 'th_biotac'" in message
    assert told["statuses"]["taxel: ff"][0] in (Level.OK, Level.STALE)


WRONG = [
    ("forces up to 150 look like grams: expected newtons", "-0.007", "150"),
    ("samples in touch pull at the skin: expected the force on the finger", "-0.007", "-1"),
    ("touched places look like millimetres, as 7: expected metres", "-7", "1"),
]


@pytest.mark.parametrize(("text", "place", "force"), WRONG)
def test_contacts_that_look_wrong_are_told_in_diagnostics(
    ros: Ros, text: str, place: str, force: str
) -> None:
    with ros.start("-m", "taxel.ros2.rclpy_node", "--ros-args", "-r", "__ns:=/rh") as node:
        try:
            told = ros.run(
                PROGRAMS / "wrong_hand.py", "1", text, place, force, "--ros-args", "-r", "__ns:=/rh"
            )
        finally:
            node.terminate()
    assert told[0] == Level.WARN
    assert text in told[1]


def test_a_strict_node_ends_at_the_first_contact_that_looks_wrong(ros: Ros) -> None:
    command = ("-m", "taxel.ros2.rclpy_node", "--ros-args", "-r", "__ns:=/rh", "-p", "strict:=true")
    with ros.start(*command, stderr=subprocess.PIPE) as node:
        try:
            told = ros.run(PROGRAMS / "wrong_hand.py", "2", *WRONG[0], "--ros-args", "-r", "__ns:=/rh")
            _, errors = node.communicate(timeout=60)
        finally:
            node.kill()
    assert node.returncode == 1
    assert f"taxel: finger ff, xgb-causal/1: {WRONG[0][0]}" in errors
    assert "Traceback" not in errors
    assert told[0] == Level.ERROR
    assert WRONG[0][0] in told[1]


@pytest.mark.parametrize(
    ("parameter", "text"),
    [
        ("inputs:=pose", "inputs is 'pose': expected wrench_and_point or tactile_contact"),
        ("model:=nothing", "nothing"),
        ("rate_hz:=-1.0", "rate_hz is -1.0"),
        ("rate_hz:=-1", "rate_hz is -1.0"),
        ("stale_after_s:=soon", "stale_after_s is 'soon': expected seconds"),
        ("rate_hz:=true", "rate_hz is True"),
        ("fingers:=ff", "the parameter fingers: .* expecting type 'STRING_ARRAY'"),
        ("fingers:=[]", r"fingers is \[\]: expected names"),
        ("model:=3", "the parameter model: "),
        ("strict:=1", "the parameter strict: .*expecting type 'BOOL'"),
    ],
)
def test_wrong_parameters_are_told(ros: Ros, parameter: str, text: str) -> None:
    command = ("-m", "taxel.ros2.rclpy_node", "--ros-args", "-p", parameter)
    with ros.start(*command, stderr=subprocess.PIPE) as node:
        _, errors = node.communicate(timeout=120)
    assert node.returncode == 1
    assert re.search(text, errors)
    assert "Traceback" not in errors

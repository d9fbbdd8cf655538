"""What a user says of fingers, the world and the frame."""

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from typer.testing import CliRunner

from taxel.commands.cli import build
from taxel.errors import SettingsError
from taxel.gazebo.settings import BridgeSettings, GazeboFinger, mount_of

FF = GazeboFinger.parsed("ff=hand/ff_distal/touch", "w")


def test_a_finger_is_named_as_in_the_sdf() -> None:
    assert GazeboFinger("ff", ("hand", "ff_distal"), FF.contacts) == FF
    assert FF.contacts == "/world/w/model/hand/link/ff_distal/sensor/touch/contact"
    assert FF.channels == "/ff/tactile"


def test_the_pages_command_names_what_its_world_has() -> None:
    page = (Path(__file__).parents[3] / "docs" / "gazebo_bridge.md").read_text()
    sdf = ElementTree.fromstring(page.partition("```xml\n")[2].partition("```")[0])
    name, text = re.findall(r"taxel gazebo --world (\w+) --finger (\S+)", page)[0]
    finger = GazeboFinger.parsed(text, name)
    model, link = finger.link
    found = sdf.find(f"world[@name='{name}']/model[@name='{model}']/link[@name='{link}']")
    assert found is not None
    sensor = found.find(f"sensor[@name='{finger.contacts.split('/')[-2]}'][@type='contact']")
    assert sensor is not None
    assert found.find(f"collision[@name='{sensor.findtext('contact/collision')}']") is not None


def test_a_finger_may_be_in_a_model_of_a_model() -> None:
    finger = GazeboFinger.parsed("th=robot/hand/th_distal/touch", "w")
    assert finger.link == ("robot", "hand", "th_distal")
    assert finger.contacts == "/world/w/model/robot/model/hand/link/th_distal/sensor/touch/contact"


@pytest.mark.parametrize("topic", ["/contacts/ff", "contacts/ff", "/contacts/ff/"])
def test_a_sensor_may_have_a_topic_of_its_own(topic: str) -> None:
    finger = GazeboFinger.parsed(f"ff=hand/ff_distal:{topic}", "w")
    assert finger == GazeboFinger("ff", ("hand", "ff_distal"), "/contacts/ff")


@pytest.mark.parametrize(
    "text",
    ["", "ff", "ff=", "ff=hand/ff_distal", "ff=tip:/a", "=hand/tip/s", "f f=hand/tip/s", "ff=hand//s/t"],
)
def test_a_finger_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match=f"^finger {re.escape(repr(text))}: expected NAME=MODEL/LINK/S"):
        GazeboFinger.parsed(text, "w")


def test_names_that_gazebo_does_not_allow_are_refused() -> None:
    with pytest.raises(SettingsError, match="topic '/a@b': expected a name"):
        GazeboFinger.parsed("ff=hand/tip:/a@b", "w")
    with pytest.raises(SettingsError, match="world '/world/my world/clock'"):
        BridgeSettings("my world", (FF,))
    with pytest.raises(SettingsError, match="world '/world/my world': expected"):
        GazeboFinger.parsed("ff=hand/tip/touch", "my world")
    with pytest.raises(SettingsError, match=r"topic of poses '/a\*'"):
        BridgeSettings("w", (FF,), "/a*")


def test_the_worlds_own_topics_are_the_default() -> None:
    settings = BridgeSettings("w", (FF,))
    assert (settings.clock, settings.pose_topic) == ("/world/w/clock", "/world/w/dynamic_pose/info")
    assert BridgeSettings("w", (FF,), "/model/hand/pose").pose_topic == "/model/hand/pose"


def test_fingers_and_rates_that_cannot_be_are_refused() -> None:
    for fingers in ((), (FF, FF)):
        with pytest.raises(SettingsError, match="expected names, each of them once"):
            BridgeSettings("w", fingers)
    for rate in (0.0, 1e6, math.nan):
        with pytest.raises(SettingsError, match="expected steps a second, 1 to 100000"):
            BridgeSettings("w", (FF,), rate_hz=rate)


def test_a_frame_is_a_pose_of_sdf() -> None:
    roll, pitch, yaw = 0.3, -0.5, 1.1
    about_x = [[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]]
    about_y = [[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]]
    about_z = [[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]]
    mount = mount_of(f"0.01 0 -0.002  {roll} {pitch} {yaw}")
    np.testing.assert_array_equal(mount.position, [0.01, 0.0, -0.002])
    expected = np.array(about_z) @ np.array(about_y) @ np.array(about_x)
    np.testing.assert_allclose(mount.rotation, expected, atol=1e-15)


@pytest.mark.parametrize("text", ["", "0 0 0", "0 0 0 0 0 nan", "0 0 0 0 0 x", "0 0 0 0 0 0 0"])
def test_a_frame_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="expected 'X Y Z ROLL PITCH YAW'"):
        mount_of(text)


def test_the_command_says_that_it_was_not_run_with_gazebo() -> None:
    shown = CliRunner().invoke(build(), ["gazebo", "--help"], terminal_width=200)
    assert shown.exit_code == 0
    assert "Untested with Gazebo itself" in shown.output


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--finger", "ff=tip"], "expected NAME=MODEL"),
        (["--finger", "f=a/b/c", "--frame", "0"], "X Y Z ROLL"),
    ],
)
def test_the_command_refuses_what_is_wrong_before_it_opens_anything(options: list[str], told: str) -> None:
    done = CliRunner().invoke(build(), ["gazebo", "--world", "w", *options])
    assert done.exit_code == 2
    assert told in done.output

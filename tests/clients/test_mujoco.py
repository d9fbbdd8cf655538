"""Fingertips in MuJoCo: right place, right sign, no step that waits."""

import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import taxel
import taxel.mujoco
from taxel.errors import InputWarning, InvalidArgument
from taxel.local import shipped_repository
from taxel.predictor import Predictor

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "mujoco_fingertip.py"
WEIGHT_N = 0.1 * 9.81
SCENE = """
<mujoco>
  <worldbody>
    <geom name="table" type="box" size="0.2 0.2 0.01" pos="0 0 -0.01"/>
    <body name="left" pos="0 0 0.007" euler="0 0 90"><freejoint/>
      <geom name="tip" type="sphere" size="0.007" mass="0.1"/>
      <site name="left" size="0.02"/>
    </body>
    <body name="right" pos="0.1 0 0.5"><geom type="sphere" size="0.007"/><site name="right"/></body>
  </worldbody>
  <sensor>
    <contact name="net" geom1="tip" num="1" data="found force torque dist pos normal" reduce="netforce"/>
  </sensor>
</mujoco>
"""


@pytest.fixture(scope="module")
def predictor() -> Predictor:
    return taxel.load(shipped_repository()).predictor("xgb")


def scene(*sites: str) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(SCENE)
    for site in sites:
        taxel.mujoco.add_sensor(spec, site)
    return spec.compile()


def test_a_finger_that_rests_on_a_box_carries_its_weight(predictor: Predictor) -> None:
    model = scene("left", "right")
    data = mujoco.MjData(model)
    tips = taxel.mujoco.Fingertips(model, predictor)
    for _ in range(300):
        mujoco.mj_step(model, data)
        tips.step(data)
    assert tips.contact is not None
    np.testing.assert_allclose(tips.contact.force[0], [0, 0, WEIGHT_N], atol=1e-3)
    np.testing.assert_allclose(tips.contact.position[0], [0, 0, -0.007], atol=1e-5)
    assert tips.contact.touched.tolist() == [True, False]
    window = np.zeros((2, 12), np.float32)
    window[:, :3], window[0, [5, 8, 11]] = tips.contact.position, tips.contact.force[0, 2]
    expected = predictor.predict(window)
    # The resting finger's force is steady to the last bits only, so a threshold may lie between.
    np.testing.assert_allclose(data.sensor("left_taxel").data, expected[0], atol=25)
    np.testing.assert_array_equal(data.sensor("right_taxel").data, expected[1])


def test_the_contact_sensor_tells_the_same(predictor: Predictor) -> None:
    model = scene("left")
    data = mujoco.MjData(model)
    every = taxel.mujoco.Fingertips(model, predictor)
    net = taxel.mujoco.Fingertips(model, predictor, contacts=["net"])
    for _ in range(60):
        mujoco.mj_step(model, data)
        every.step(data)
        net.step(data)
    assert every.contact is not None
    assert net.contact is not None
    np.testing.assert_allclose(net.contact.force, every.contact.force, atol=1e-9)
    np.testing.assert_allclose(net.contact.position, every.contact.position, atol=1e-9)


@pytest.mark.parametrize(
    "objects",
    [
        'geom1="table" geom2="tip"',
        'geom2="tip"',
        'body1="left"',
        'subtree1="left"',
        'site="left" geom2="tip"',
        'subtree2="left"',
    ],
)
def test_a_contact_sensor_may_name_the_fingertip_second(objects: str, predictor: Predictor) -> None:
    spec = mujoco.MjSpec.from_string(SCENE.replace('geom1="tip"', objects))
    taxel.mujoco.add_sensor(spec, "left")
    model = spec.compile()
    data = mujoco.MjData(model)
    net = taxel.mujoco.Fingertips(model, predictor, contacts=["net"])
    for _ in range(300):
        mujoco.mj_step(model, data)
        net.step(data)
    assert net.contact is not None
    np.testing.assert_allclose(net.contact.force, [[0, 0, WEIGHT_N]], atol=1e-3)


@pytest.mark.parametrize(
    ("before", "after", "text"),
    [
        ("netforce", "maxforce", "reduce='netforce'"),
        ('num="1" data="found force torque dist pos normal"', 'num="14" data="found"', "num='1'"),
        ('num="1" data="found force torque dist pos normal"', 'num="2" data="found force pos"', "num='1'"),
        ('geom1="tip"', 'geom1="table"', "neither object .* is a fingertip: expected a geom of 'left'"),
        ('geom1="tip"', 'site="left"', "neither object"),
    ],
)
def test_another_contact_sensor_is_refused(before: str, after: str, text: str) -> None:
    model = mujoco.MjModel.from_xml_string(SCENE.replace(before, after))
    with pytest.raises(InvalidArgument, match=text):
        taxel.mujoco.SiteContacts(model, ["left"], ["net"])


def test_a_site_that_nothing_can_touch_is_told() -> None:
    tip = '<geom name="tip" type="sphere" size="0.007" mass="0.1"/>'
    for geom in (
        f'<body><joint/>{tip}</body><geom size="0.01" contype="0" conaffinity="0"/>',
        f'<body><joint/>{tip}</body><inertial pos="0 0 0" mass="0.1" diaginertia="1 1 1"/>',
    ):
        model = mujoco.MjModel.from_xml_string(SCENE.replace(tip, geom))
        with pytest.raises(InvalidArgument, match="site 'left' is on a body without a geom that can touch"):
            taxel.mujoco.SiteContacts(model, ["left", "right"])
    other = SCENE.replace('<site name="right"/>', "").replace(tip, f'{tip}<site name="right"/>')
    model = mujoco.MjModel.from_xml_string(other)
    with pytest.raises(InvalidArgument, match="site 'right' is on the body of another fingertip"):
        taxel.mujoco.SiteContacts(model, ["left", "right"])
    with pytest.raises(InvalidArgument, match="site 'left' comes twice"):
        taxel.mujoco.SiteContacts(model, ["left", "left"])


def test_a_pad_that_is_fixed_to_the_fingertip_is_part_of_it() -> None:
    """As where the site's own body has a nail, or nothing."""
    tip = '<geom name="tip" type="sphere" size="0.007" mass="0.1"/>'
    data = []
    for geoms in (tip, f'<geom size="0.001" pos="0 0 0.006" mass="0"/><body>{tip}</body>'):
        model = mujoco.MjModel.from_xml_string(SCENE.replace(tip, geoms))
        data.append(mujoco.MjData(model))
        for _ in range(300):
            mujoco.mj_step(model, data[-1])
        sample = taxel.mujoco.SiteContacts(model, ["left", "right"]).read(data[-1])
        np.testing.assert_allclose(sample.force, [[0.0, 0.0, WEIGHT_N], [0.0, 0.0, 0.0]], atol=1e-3)
    with pytest.raises(InvalidArgument, match=r"of another model, as after `spec.recompile`"):
        taxel.mujoco.SiteContacts(model, ["left"]).read(data[0])


HAND = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="hand"><geom size="0.01" pos="-0.1 0 0"/>
      <body name="index"><joint type="slide" axis="0 0 1" damping="1"/>
        <geom name="index" size="0.007" mass="0.05"/><site name="index"/>
      </body>
      <body name="thumb" pos="0 0 -0.0138" euler="180 0 0"><joint type="slide" axis="0 0 1" damping="1"/>
        <geom name="thumb" size="0.007" mass="0.05"/><site name="thumb"/>
      </body>
    </body>
  </worldbody>
  <sensor>
    <contact name="net" {objects} num="1" data="found force torque dist pos normal" reduce="netforce"/>
  </sensor>
</mujoco>
"""


@pytest.mark.parametrize("objects", ['subtree1="hand" geom2="thumb"', 'body1="index" body2="thumb"'])
def test_a_hand_that_a_fingertip_is_of_is_no_fingertip(objects: str) -> None:
    model = mujoco.MjModel.from_xml_string(HAND.format(objects=objects))
    data = mujoco.MjData(model)
    data.xfrc_applied[2:4, 2] = -1.0, 1.0
    for _ in range(300):
        mujoco.mj_step(model, data)
    read = taxel.mujoco.SiteContacts(model, ["thumb"], ["net"]).read(data)
    np.testing.assert_allclose(read.force, [[0, 0, 1]], atol=1e-3)
    np.testing.assert_allclose(read.force, taxel.mujoco.SiteContacts(model, ["thumb"]).read(data).force)
    alone = mujoco.MjModel.from_xml_string(HAND.format(objects='subtree1="hand"'))
    with pytest.raises(InvalidArgument, match="neither object"):
        taxel.mujoco.SiteContacts(alone, ["thumb"], ["net"])


def test_data_of_several_simulations_are_told(predictor: Predictor) -> None:
    """In turn, each would give the other a past that it never had. One after the other, each begins."""
    model = scene("left")
    tips = taxel.mujoco.Fingertips(model, predictor)
    first, second = mujoco.MjData(model), mujoco.MjData(model)
    second.qpos[2] = 0.5

    def play(data: mujoco.MjData, steps: int) -> np.ndarray:
        for _ in range(steps):
            mujoco.mj_step(model, data)
            channels = tips.step(data)
        return channels

    of_first, of_second = play(first, 60), play(second, 60)
    assert (of_first != of_second).any()
    with pytest.raises(InvalidArgument, match="followed another MjData"):
        play(first, 1)
    tips.reset()
    play(first, 1)
    mujoco.mj_resetData(model, second)
    second.qpos[2] = 0.5
    np.testing.assert_array_equal(play(second, 60), of_second)


def test_fingertips_may_step_more_rarely_than_the_simulation(predictor: Predictor) -> None:
    """As with the frame skip of an environment. Samples come at their own times."""
    model = scene("left")
    channels = []
    for rate_hz in (None, 50):
        data, tips = mujoco.MjData(model), taxel.mujoco.Fingertips(model, predictor, rate_hz=rate_hz)
        for _ in range(50):
            mujoco.mj_step(model, data, 10)
            tips.step(data)
        channels.append(tips.fingers.channels)
    np.testing.assert_array_equal(channels[0], channels[1])
    with pytest.raises(InvalidArgument, match="rate_hz is 0"):
        taxel.mujoco.Fingertips(model, predictor, rate_hz=0)


def test_data_that_were_never_stepped_are_told(predictor: Predictor) -> None:
    model = scene("left")
    data, tips = mujoco.MjData(model), taxel.mujoco.Fingertips(model, predictor)
    with pytest.raises(InvalidArgument, match="no poses yet: expected `mj_step` or `mj_forward`"):
        tips.step(data)
    mujoco.mj_step(model, data)
    tips.step(data)
    mujoco.mj_resetData(model, data)
    with pytest.raises(InvalidArgument, match="no poses yet"):
        tips.step(data)
    mujoco.mj_forward(model, data)
    tips.step(data)


def test_a_simulation_that_has_diverged_is_told(predictor: Predictor) -> None:
    model = scene("left")
    data, tips = mujoco.MjData(model), taxel.mujoco.Fingertips(model, predictor)
    mujoco.mj_step(model, data)
    tips.step(data)
    data.time = np.nan
    with pytest.raises(InvalidArgument, match="time is nan: expected finite seconds"):
        tips.step(data)


@pytest.mark.skipif(
    not hasattr(mujoco.mjtEnableBit, "mjENBL_SLEEP"), reason="this version of MuJoCo lets no body sleep"
)
def test_bodies_that_fall_asleep_are_told(predictor: Predictor) -> None:
    asleep = SCENE.replace("<mujoco>", '<mujoco><option><flag sleep="enable"/></option>')
    spec = mujoco.MjSpec.from_string(asleep)
    taxel.mujoco.add_sensor(spec, "left")
    model = spec.compile()
    with pytest.warns(InputWarning, match="lets bodies fall asleep"):
        taxel.mujoco.Fingertips(model, predictor)
    with pytest.raises(InvalidArgument, match="lets bodies fall asleep"):
        taxel.mujoco.Fingertips(model, predictor, strict=True)


def test_disabled_sensors_are_told() -> None:
    disabled = SCENE.replace("<mujoco>", '<mujoco><option><flag sensor="disable"/></option>')
    with pytest.raises(InvalidArgument, match="sensors disabled"):
        taxel.mujoco.SiteContacts(mujoco.MjModel.from_xml_string(disabled), ["left"], ["net"])


def test_short_episodes_begin_again(predictor: Predictor) -> None:
    model = scene("left")
    data = mujoco.MjData(model)
    tips = taxel.mujoco.Fingertips(model, predictor)
    channels = []
    for steps in (30, 3, 3):
        mujoco.mj_resetData(model, data)
        for _ in range(steps):
            mujoco.mj_step(model, data)
            latest = tips.step(data)
        channels.append(latest)
    np.testing.assert_array_equal(channels[1], channels[2])
    assert (channels[0] != channels[1]).any()


def test_a_reset_of_the_simulation_is_one_of_the_fingers(predictor: Predictor) -> None:
    model = scene("left")
    data = mujoco.MjData(model)
    tips = taxel.mujoco.Fingertips(model, predictor)
    runs = []
    for _ in range(2):
        mujoco.mj_resetData(model, data)
        channels = []
        for _ in range(80):
            mujoco.mj_step(model, data)
            channels.append(tips.step(data)[0])
        runs.append(np.array(channels))
    np.testing.assert_array_equal(runs[0], runs[1])


def test_a_model_without_a_sensor_is_told(predictor: Predictor) -> None:
    with pytest.raises(InvalidArgument, match="no user sensor of 21 numbers"):
        taxel.mujoco.Fingertips(scene(), predictor)
    with pytest.raises(InvalidArgument, match="'wrist': expected a contact sensor"):
        taxel.mujoco.Fingertips(scene("left"), predictor, contacts=["wrist"])


def test_the_example_runs(tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLE), "--json", "--plot", str(tmp_path / "picture.png")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert set(json.loads(done.stdout)) == {"physics_alone", "real_time_factor", "median_us", "p99_us"}
    assert (tmp_path / "picture.png").stat().st_size > 10_000


def test_a_site_that_is_none_is_told() -> None:
    with pytest.raises(InvalidArgument, match="'thumb': expected the name of a site"):
        taxel.mujoco.SiteContacts(scene("left"), ["left", "thumb"])
    with pytest.raises(InvalidArgument, match="site 9: expected a number below 2"):
        taxel.mujoco.SiteContacts(scene("left"), np.array([0, 9]))
    with pytest.raises(InvalidArgument, match="contacts is 'net': expected a list of names"):
        taxel.mujoco.SiteContacts(scene("left"), ["left"], "net")
    with pytest.raises(InvalidArgument, match=r"'thumb': expected the name of a site .*: left, right"):
        taxel.mujoco.add_sensor(mujoco.MjSpec.from_string(SCENE), "thumb")

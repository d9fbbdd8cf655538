"""Recording protocols on the twin."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel.errors import SettingsError
from taxel_models.twin import perform
from taxel_models.twin.course import course_of
from taxel_models.twin.protocol import (
    Column,
    Pause,
    Place,
    Press,
    RecordingProtocol,
    SwitchOff,
    Turn,
    WarmUp,
    read_protocol,
)
from taxel_models.twin.protocol_menu import in_turn, menu
from taxel_models.twin.sensor import Sensor
from taxel_models.twin.temperature import core_celsius, on_for, tdc_counts

PLACE = Place(along_mm=-4.0, around_deg=0.0)
presses = st.builds(
    Press,
    place=st.builds(Place, along_mm=st.floats(-14, 10), around_deg=st.floats(-60, 60)),
    force_n=st.floats(0.5, 8.0),
    speed_n_s=st.floats(1.0, 20.0),
    hold_s=st.floats(0.2, 2.0),
)
breaks = st.one_of(
    st.builds(Pause, seconds=st.floats(0.5, 3.0)),
    st.builds(WarmUp, seconds=st.floats(60, 900)),
    st.builds(SwitchOff, seconds=st.floats(60, 900)),
)


@settings(max_examples=30)
@given(st.lists(st.one_of(presses, breaks), min_size=1, max_size=5), presses, st.integers(1, 2))
def test_a_recording_has_the_steps_of_its_protocol(
    some: list[Press | Pause | WarmUp | SwitchOff], last: Press, repeat: int
) -> None:
    """Rows, gaps, contacts and forces are those of the steps; what follows the last row opens no gap."""
    protocol = RecordingProtocol(name="any", repeat=repeat, steps=(*some, last))
    course = course_of(protocol, 7.0, np.random.default_rng(5))
    steps = list(protocol.all_steps())
    assert course.rows == pytest.approx(protocol.recorded_s * 100, abs=1)
    gaps, unrecorded, recorded = [], 0.0, False
    for step in steps:
        if isinstance(step, (WarmUp, SwitchOff)):
            unrecorded += step.seconds if recorded else 0.0
        else:
            gaps += [unrecorded] if unrecorded else []
            unrecorded, recorded = 0.0, True
    between = np.diff(course.time_s)
    np.testing.assert_allclose(between[between > 0.5] - 0.01, gaps, atol=1e-6)
    held = [step for step in steps if isinstance(step, Press)]
    pressed = np.concatenate([[0], (course.contacts.press > 0).astype(int), [0]])
    starts, stops = np.flatnonzero(np.diff(pressed) == 1), np.flatnonzero(np.diff(pressed) == -1)
    assert len(starts) == len(held)
    for start, stop, press in zip(starts, stops, held, strict=True):
        assert course.contacts.press[start:stop].max() == pytest.approx(press.force_n, rel=0.3)
        seconds = press.hold_s + 2 * press.force_n / press.speed_n_s
        assert (stop - start) / 100 == pytest.approx(seconds, abs=0.03)


def test_a_finger_cools_while_it_is_off_and_warms_up_while_it_is_on() -> None:
    press = Press(place=PLACE, force_n=2.0)
    steps = (press, SwitchOff(seconds=600), press, WarmUp(seconds=600), press)
    recording = perform(RecordingProtocol(name="any", steps=steps), 1)
    levels = [recording.auxiliary["tdc"][part].mean() for part in recording.segments]
    assert levels[1] < levels[0] - 20
    assert levels[2] > levels[1] + 20
    assert on_for(float(tdc_counts(core_celsius(2, np.zeros(2), 777.0))[0])) == pytest.approx(777.0)


def test_a_turned_finger_is_touched_on_another_side() -> None:
    press = Press(place=PLACE, force_n=2.0)
    steps = (press, Turn(degrees=50), press, Column(column="material", value=4))
    recording = perform(
        RecordingProtocol(name="any", steps=(Column(column="material", value=1), *steps)), 1
    )
    half = len(recording) // 2
    angle = [
        np.degrees(np.arctan2(*np.median(part, axis=0)[[1, 2]] * [1, -1]))
        for part in (recording.samples.position[60:half], recording.samples.position[half + 60 :])
    ]
    assert angle[1] - angle[0] == pytest.approx(50, abs=15)
    assert set(recording.covariates["material"]) == {1.0}


def test_the_menu_can_be_recorded_and_kept(tmp_path: Path) -> None:
    """Within the skin, at the force that was asked for; a file gives the same protocol again."""
    protocols = [*menu(3.0), in_turn(3.0, "material", [1.0, 2.0, 5.0])]
    assert len({protocol.name for protocol in protocols}) == len(protocols)
    for protocol in protocols:
        path = tmp_path / "protocol.json"
        path.write_text(protocol.model_dump_json())
        assert read_protocol(path) == protocol
        assert 80 <= protocol.recorded_s <= 300
    for protocol in protocols[::4]:
        recording = perform(protocol, 2)
        force = np.linalg.norm(recording.samples.force, axis=1)
        assert np.quantile(force, 0.95) == pytest.approx(3.0, rel=0.3)
        assert np.abs(recording.samples.position * 1e3).max() < Sensor.biotac_2p().skin_radius + 25
    assert set(perform(protocols[-1], 2).covariates["material"]) == {1.0, 2.0, 5.0}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "JSON"),
        ('{"name": "x", "steps": []}', "steps"),
        ('{"name": "x", "steps": [{"kind": "squeeze"}]}', "squeeze"),
        ('{"name": "x", "steps": [{"kind": "warm_up", "seconds": 9}]}', "0 s are recorded"),
        ('{"name": "x", "steps": [{"kind": "pause", "seconds": 9}], "repeat": 999}', "8991 s are recorded"),
    ],
)
def test_what_is_no_protocol_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "protocol.json"
    path.write_text(text)
    with pytest.raises(SettingsError, match=message):
        read_protocol(path)
    with pytest.raises(SettingsError, match="No such file"):
        read_protocol(tmp_path / "none.json")

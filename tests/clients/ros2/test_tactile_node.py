"""A node's fingers, without a transport: pairs, frames of reference, rates, silence, and hands."""

import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxel.contacts import fingertip_contacts
from taxel.errors import InputWarning, InvalidArgument, SettingsError, Unavailable
from taxel.predictor import Predictor
from taxel.ros2.finger_input import ContactMessage, FingerInput, Sample, Vector
from taxel.ros2.messages import Level, Status
from taxel.ros2.settings import Inputs, NodeSettings
from taxel.ros2.tactile_node import HandFrame, Prediction, TactileNode
from taxel.skin import PAD

START = 1_700_000_000_000_000_000
TICK = 10_000_000
PLACE = (0.0, 0.0, -0.007)
FORCE = (0.0, 0.0, 1.0)


def wrench(
    stamp_ns: int, force: tuple[float, float, float] = FORCE, frame: str = "ff_biotac"
) -> ContactMessage:
    return ContactMessage(stamp_ns, frame, None, force)


def point(
    stamp_ns: int, place: tuple[float, float, float] = PLACE, frame: str = "ff_biotac"
) -> ContactMessage:
    return ContactMessage(stamp_ns, frame, place, None)


def taken(source: FingerInput, messages: Iterable[ContactMessage]) -> list[Sample]:
    samples = (source.take(message, 0.0) for message in messages)
    return [sample for sample in samples if sample is not None]


@given(st.booleans(), st.integers(0, 4_999_999))
def test_a_wrench_and_a_point_near_in_time_are_one_sample(first: bool, apart_ns: int) -> None:
    source = FingerInput("ff", NodeSettings())
    for step in range(5):
        pair = [wrench(START + step * TICK), point(START + step * TICK + apart_ns)]
        (sample,) = taken(source, pair if first else pair[::-1])
        assert sample.stamp_ns == START + step * TICK
        assert sample.position == pytest.approx(PLACE)
        assert sample.force == pytest.approx(FORCE)
    assert (source.samples, source.refused) == (5, 0)


def test_a_wrench_without_a_point_is_told() -> None:
    source = FingerInput("ff", NodeSettings())
    assert (
        taken(source, [point(START + 6_000_000), *(wrench(START + 2 * k * TICK) for k in range(11))]) == []
    )
    status = source.status(0.0)
    assert status.level is Level.ERROR
    assert "a wrench without a point within 5 ms" in status.message


def test_points_and_wrenches_that_come_in_bunches_find_each_other() -> None:
    source = FingerInput("ff", NodeSettings())
    points = [point(START + k * TICK) for k in range(8)]
    samples = taken(source, [*points, *(wrench(START + k * TICK) for k in range(8))])
    assert [sample.stamp_ns for sample in samples] == [START + k * TICK for k in range(8)]
    assert source.refused == 0


def test_where_nothing_touches_no_point_is_needed_and_the_place_stays() -> None:
    source = FingerInput("ff", NodeSettings())
    before, during, after = taken(
        source,
        [
            wrench(START, (0.0, 0.0, 0.0)),
            point(START + TICK, (0.0, 0.004, -0.006)),
            wrench(START + TICK),
            wrench(START + 2 * TICK, (0.0, 0.0, 0.0)),
        ],
    )
    assert before.position == pytest.approx(PAD)
    assert np.linalg.norm(during.position) == pytest.approx(0.007)
    assert after.position.tolist() == during.position.tolist()
    assert after.force.tolist() == [0.0, 0.0, 0.0]


NUMBERS = st.integers(-30_000, 30_000).map(lambda micro: micro * 1e-6)


@pytest.mark.filterwarnings("ignore::taxel.errors.InputWarning")
@given(st.tuples(NUMBERS, NUMBERS, NUMBERS), st.tuples(NUMBERS, NUMBERS, NUMBERS))
def test_a_sample_is_the_one_of_the_contacts_of_simulators(
    place: tuple[float, float, float], force: tuple[float, float, float]
) -> None:
    source = FingerInput("ff", NodeSettings(inputs=Inputs.TACTILE_CONTACT))
    (sample,) = taken(source, [ContactMessage(START, "ff_biotac", place, force)])
    expected = fingertip_contacts([place], [force], np.zeros(3), np.eye(3))
    np.testing.assert_allclose(sample.position, expected.position[0], atol=1e-15)
    np.testing.assert_allclose(sample.force, expected.force[0], atol=1e-15)


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (wrench(START, frame="world"), "frame 'world': expected 'ff_biotac'"),
        (wrench(0), "without a time"),
        (wrench(START, (float("nan"), 0.0, 0.0)), "force (nan, 0.0, 0.0): expected finite numbers"),
        (point(START, (0.0, float("inf"), 0.0)), "expected finite numbers"),
    ],
)
def test_messages_that_cannot_be_used_are_refused_by_name(message: ContactMessage, text: str) -> None:
    source = FingerInput("ff", NodeSettings())
    assert source.take(message, 0.0) is None
    status = source.status(0.5)
    assert (status.level, source.refused) == (Level.ERROR, 1)
    assert text in status.message


def test_a_fault_is_told_at_least_once_and_then_for_a_second() -> None:
    source = FingerInput("ff", NodeSettings(stale_after_s=100.0))
    taken(source, [wrench(START, (0.0, 0.0, 0.0))])
    source.take(wrench(START + TICK, frame="world"), 0.0)
    assert [source.status(now_s).level for now_s in (5.0, 5.1)] == [Level.ERROR, Level.OK]
    source.take(wrench(START + TICK, frame="world"), 6.0)
    assert [source.status(now_s).level for now_s in (6.1, 6.9, 7.1)] == [Level.ERROR, Level.ERROR, Level.OK]


def test_millimetres_are_told() -> None:
    source = FingerInput("ff", NodeSettings())
    taken(source, [point(START, (0.0, 0.0, -7.0)), wrench(START)])
    assert "a contact 6993 mm from the skin: expected metres" in source.status(0.0).message


def test_another_rate_and_silence_are_told() -> None:
    source = FingerInput("ff", NodeSettings(inputs=Inputs.TACTILE_CONTACT))
    assert source.status(0.0).level is Level.STALE
    taken(
        source, [ContactMessage(START + step * 2_000_000, "ff_biotac", PLACE, FORCE) for step in range(9)]
    )
    status = source.status(0.0)
    assert (status.level, status.values["rate_hz"]) == (Level.WARN, "500.0")
    assert "contacts come at 500.0 Hz: expected 100" in status.message
    late = source.status(2.0)
    assert late.level is Level.STALE
    assert "no contact for 2.0 s" in late.message


def test_messages_give_the_channels_of_the_models_own_stream(predictor: Predictor) -> None:
    rng = np.random.default_rng(1)
    node = TactileNode(predictor, NodeSettings(("ff",), inputs=Inputs.TACTILE_CONTACT))
    stream = predictor.stream()
    sides = np.column_stack([rng.uniform(-0.004, 0.004, 60), np.zeros((60, 2))])
    given: list[Prediction] = []
    expected: list[np.ndarray[tuple[int, ...], np.dtype[np.float32]]] = []
    for step, (x, _, _) in enumerate(sides):
        position, force = (min(x, 0.0), 0.0, -0.007), (0.1, 0.0, 0.5 + 0.01 * step)
        message = ContactMessage(START + step * TICK, "ff_biotac", position, force)
        given += node.take("ff", message, step * 0.01).predictions
        for window in stream.push_ns(START + step * TICK, position, force):
            expected.append(predictor.predict(window.values)[0])
    assert len(given) == len(expected) > 20
    np.testing.assert_array_equal([one.channels for one in given], expected)


WRONG = [
    (PLACE, (0.0, 0.0, -1.0), "finger ff, xgb/1: the forces of .* samples in touch pull at the skin"),
    (PLACE, (0.0, 0.0, 101.97), "finger ff, xgb/1: forces up to 102 look like grams: expected newtons"),
    ((0.0, 0.0, -7.0), FORCE, "touched places look like millimetres, as 7: expected metres"),
    ((0.0, 0.0, -0.0115), FORCE, "touched places are off the skin, one of them 4.5 mm outside it"),
    (PLACE, (0.0, 0.0, 12.0), "fz of 12 N: expected -"),
]
TACTILE = NodeSettings(("ff", "th"), "tip", Inputs.TACTILE_CONTACT, stale_after_s=100.0)


def play(node: TactileNode, start: int, steps: int, place: Vector, force: Vector) -> list[Prediction]:
    given: list[Prediction] = []
    for step in range(start, start + steps):
        message = ContactMessage(START + step * TICK, "tip", place, force)
        given += node.take("ff", message, step * 0.01).predictions
        node.take("th", message._replace(place=PLACE, force=FORCE), step * 0.01)
    return given


@pytest.mark.parametrize(("place", "force", "text"), WRONG)
def test_contacts_that_look_wrong_are_told_in_diagnostics_until_they_look_right(
    predictor: Predictor, place: Vector, force: Vector, text: str
) -> None:
    node = TactileNode(predictor, TACTILE)
    play(node, 0, 150, PLACE, FORCE)
    _, right, _ = node.statuses(1.5)
    assert (right.level, right.message) == (Level.OK, "contacts come as expected")
    with pytest.warns(InputWarning, match=text):
        given = play(node, 150, 300, place, force)
    assert len(given) == 300
    # Longer than a fault is reported: the warning came once, and what it says is so still.
    _, wrong, other = node.statuses(9.0)
    assert wrong.level is Level.WARN
    assert re.search(text, wrong.message)
    assert (other.level, other.message) == (Level.OK, "contacts come as expected")
    play(node, 450, 300, PLACE, (0.0, 0.0, 0.0))
    assert node.statuses(18.0)[1].level is Level.WARN
    play(node, 750, 300, PLACE, FORCE)
    assert node.statuses(27.0)[1].level is Level.OK


@pytest.mark.parametrize(("place", "force", "text"), WRONG)
def test_a_strict_node_ends_at_the_first_contact_that_looks_wrong(
    predictor: Predictor, place: Vector, force: Vector, text: str
) -> None:
    node = TactileNode(predictor, replace(TACTILE, strict=True))
    play(node, 0, 150, PLACE, FORCE)
    with pytest.raises(InvalidArgument, match=text):
        play(node, 150, 300, place, force)
    status = node.statuses(4.5)[1]
    assert status.level is Level.ERROR
    assert re.search(text, status.message)


def test_a_strict_node_ends_where_contacts_come_at_another_rate(predictor: Predictor) -> None:
    def at_500_hz(settings: NodeSettings) -> TactileNode:
        node = TactileNode(predictor, settings)
        for step in range(120):
            node.take("ff", ContactMessage(START + step * TICK // 5, "tip", PLACE, FORCE), 0.0)
        return node

    with pytest.raises(InvalidArgument, match=r"finger ff: samples come every 2 ms .* rate_hz=500"):
        at_500_hz(replace(TACTILE, strict=True))
    assert at_500_hz(TACTILE).statuses(0.0)[1].level is Level.ERROR
    with pytest.raises(InvalidArgument, match="finger ff, xgb/1: a sample every 50 ms"):
        TactileNode(predictor, replace(TACTILE, strict=True, rate_hz=20.0))


def test_messages_that_are_refused_do_not_end_a_strict_node(predictor: Predictor) -> None:
    node = TactileNode(predictor, replace(TACTILE, strict=True))
    for message in (wrench(START, frame="world"), wrench(0, frame="tip"), point(START, frame="tip")):
        node.take("ff", message._replace(force=message.force or FORCE, place=PLACE), 0.0)
    # Once more at the same time, and far back in time.
    for step in (0, 0, -1000):
        play(node, step, 1, PLACE, FORCE)
    assert node.statuses(0.0)[1].level is Level.ERROR


def test_a_strict_node_of_a_model_without_known_contacts_looks_at_the_skin_alone(
    predictor: Predictor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(predictor), "input_check", lambda *_, **__: None)
    node = TactileNode(predictor, replace(TACTILE, strict=True))
    play(node, 0, 20, PLACE, (0.0, 0.0, 300.0))
    with pytest.raises(InvalidArgument, match="finger ff: a contact 6993 mm from the skin"):
        play(node, 20, 1, (0.0, 0.0, -7.0), FORCE)


def hands(node: TactileNode, fingers: Iterable[str], step: int) -> list[HandFrame]:
    message = ContactMessage(START + step * TICK, "tip", PLACE, FORCE)
    outputs = [node.take(finger, message, step * 0.01) for finger in fingers]
    return [frame for output in outputs for frame in output.hand]


def test_a_hand_comes_once_a_period_with_the_fingers_that_are_not_stale(predictor: Predictor) -> None:
    settings = NodeSettings(("ff", "mf", "th"), frame_id="tip", inputs=Inputs.TACTILE_CONTACT)
    node = TactileNode(predictor, settings)
    all_three = [hands(node, settings.fingers, step) for step in range(60)]
    complete = [frames for frames in all_three if frames]
    assert len(complete) > 20
    assert all(len(frames) == 1 and set(frames[0].channels) == {"ff", "mf", "th"} for frames in complete)
    assert [frames[0].stamp_ns for frames in complete] == sorted({f[0].stamp_ns for f in complete})
    # One finger falls silent: it is left out once it is stale, and the others still come in time.
    without = [hands(node, ("ff", "mf"), step) for step in range(60, 160)]
    assert [len(frames) for frames in without[60:]] == [1] * 40
    assert set(without[-1][0].channels) == {"ff", "mf"}


def test_time_that_goes_back_begins_again(predictor: Predictor) -> None:
    node = TactileNode(predictor, NodeSettings(("ff",), "ff_biotac", Inputs.TACTILE_CONTACT))
    first = [
        node.take("ff", ContactMessage(START + step * TICK, "ff_biotac", PLACE, FORCE), 0.0).predictions
        for step in range(40)
    ]
    again = [
        node.take("ff", ContactMessage(TICK + step * TICK, "ff_biotac", PLACE, FORCE), 0.0).predictions
        for step in range(40)
    ]
    assert [len(each) for each in again] == [len(each) for each in first]
    assert any("time went back" in status.message for status in node.statuses(0.0))
    repeated = ContactMessage(40 * TICK, "ff_biotac", PLACE, FORCE)
    assert node.take("ff", repeated, 0.0).predictions == []
    assert any("is not after" in status.message for status in node.statuses(0.0))


def test_a_predictor_that_fails_is_told_and_asked_again(
    predictor: Predictor, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = TactileNode(predictor, NodeSettings(("ff",), inputs=Inputs.TACTILE_CONTACT))

    def lost(*_: object, **__: object) -> None:
        raise Unavailable("nobody answers")

    def step(number: int) -> list[Prediction]:
        message = ContactMessage(START + number * TICK, "ff_biotac", PLACE, FORCE)
        return node.take("ff", message, number * 0.01).predictions

    for number in range(40):
        step(number)
    with monkeypatch.context() as patched:
        patched.setattr(predictor, "predict", lost)
        assert step(40) == []
    own: Status = node.statuses(0.4)[0]
    assert (own.level, own.message) == (Level.ERROR, "nobody answers")
    assert len(step(41)) == 1
    assert node.statuses(9.0)[0].level is Level.OK


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"fingers": ()}, "expected names"),
        ({"fingers": ("ff", "ff")}, "each of them once"),
        ({"fingers": ("f/f",)}, "finger 'f/f'"),
        ({"frame_id": "{hand}_tip"}, "frame_id is '{hand}_tip'"),
        ({"rate_hz": 0.0}, "rate_hz is 0.0"),
        ({"stale_after_s": float("nan")}, "stale_after_s is nan"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, object], text: str) -> None:
    with pytest.raises(SettingsError, match="expected") as caught:
        NodeSettings(**settings)  # type: ignore[arg-type]
    assert text in str(caught.value)

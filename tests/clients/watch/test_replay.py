"""A replay's clock, and what its updates hold."""

import json
from typing import Any

import numpy as np
import pytest

from taxel_watch.messages import encoded, scene_message, update_message
from taxel_watch.replay import Predictions, Replay
from taxel_watch.scene import HISTORY_S, MEASURED, PREDICTED, Player, Update

ROWS = 600


def newest(player: Player) -> Update:
    update = player.update()
    assert update is not None
    return update


def test_frames_follow_the_clock_and_leave_no_row_out(paced: Replay, clock: Any) -> None:
    player = paced.player()
    assert player.scene() is not None
    rows = [newest(player).fingers["0"].time_s]
    for step in (0.01, 0.033, 0.2, 1.0):
        clock.now += step
        rows.append(newest(player).fingers["0"].time_s)
    np.testing.assert_allclose(np.concatenate(rows), 0.01 * np.arange(125), atol=1e-9)
    assert player.update() is None


def test_a_frame_holds_the_recording_and_the_predictions(paced: Replay, clock: Any) -> None:
    player = paced.player()
    player.command("pause", 0)
    player.command("seek", 3.0)
    block = newest(player).fingers["1"]
    recording = paced.recordings[1]
    np.testing.assert_array_equal(block.force[-1], recording.samples.force[300])
    np.testing.assert_array_equal(block.counts[MEASURED][-1], recording.channels[300])
    np.testing.assert_array_equal(block.counts[PREDICTED][-1], recording.channels[300] - 60)


def test_rest_is_what_the_untouched_finger_reads(paced: Replay) -> None:
    rest = paced.scene().fingers[0].rest
    np.testing.assert_allclose(rest, 2000.0 + 10 * np.arange(21))


def test_pause_step_seek_and_speed(paced: Replay, clock: Any) -> None:
    player = paced.player()
    clock.now += 1.0
    player.command("pause", 0)
    clock.now += 5.0
    assert newest(player).at_s == pytest.approx(1.0)
    player.command("step", -1)
    assert newest(player).at_s == pytest.approx(0.99)
    player.command("speed", 2.0)
    player.command("play", 0)
    clock.now += 0.5
    assert newest(player).at_s == pytest.approx(1.99)
    player.command("seek", -3.0)
    assert newest(player).at_s == 0.0
    player.command("seek", 1e9)
    assert newest(player).at_s == pytest.approx(0.01 * (ROWS - 1))
    player.command("dance", 1.0)
    assert player.update() is None


def test_a_seek_brings_the_past_that_the_charts_show(paced: Replay) -> None:
    player = paced.player()
    player.command("pause", 0)
    newest(player)
    player.command("seek", 5.0)
    update = newest(player)
    time = update.fingers["0"].time_s
    assert update.restarts
    assert time[-1] == pytest.approx(5.0)
    assert time[0] <= 0.05
    assert (np.diff(time) <= 0.03 + 1e-9).all()
    assert time[-1] - time[0] <= HISTORY_S


def test_at_its_end_a_recording_stops_and_plays_again_when_told(paced: Replay, clock: Any) -> None:
    player = paced.player()
    clock.now += 60.0
    assert newest(player).at_s == pytest.approx(5.99)
    assert player.status()["state"] == "paused"
    player.command("play", 0)
    clock.now += 0.1
    update = newest(player)
    assert update.restarts
    assert update.at_s == pytest.approx(0.1)


def test_a_demo_begins_again(paced: Replay, clock: Any) -> None:
    paced.loops = True
    player = paced.player()
    clock.now += 6.5
    assert newest(player).at_s == pytest.approx(0.5)
    assert player.status()["state"] == "playing"


def test_viewers_have_places_of_their_own(paced: Replay, clock: Any) -> None:
    one, other = paced.player(), paced.player()
    one.command("seek", 4.0)
    clock.now += 0.1
    assert newest(one).at_s == pytest.approx(4.1)
    assert newest(other).at_s == pytest.approx(0.1)


def test_predictions_that_come_later_bring_a_new_scene(measured_only: Replay) -> None:
    player = measured_only.player()
    first = player.scene()
    assert first is not None
    assert dict(first.traces) == {MEASURED: ""}
    assert player.scene() is None
    newest(player)
    counts = [{PREDICTED: recording.channels} for recording in measured_only.recordings]
    measured_only.predicted(Predictions({PREDICTED: "xgb/1"}, counts))
    second = player.scene()
    assert second is not None
    assert dict(second.traces) == {MEASURED: "", PREDICTED: "xgb/1"}
    update = newest(player)
    assert update.restarts
    assert PREDICTED in update.fingers["0"].counts


def test_messages_are_strict_json_with_none_where_nothing_is_predicted(paced: Replay) -> None:
    player = paced.player()
    player.command("pause", 0)
    player.command("seek", 0.05)
    told = json.loads(encoded(update_message(newest(player), 1)), parse_constant=pytest.fail)
    assert told["fingers"]["0"]["counts"][PREDICTED][-1] == [None] * 21
    assert told["fingers"]["0"]["counts"][MEASURED][-1] == pytest.approx([2000 + 10 * n for n in range(21)])
    scene = json.loads(encoded(scene_message(paced.scene())), parse_constant=pytest.fail)
    assert len(scene["skin"]["electrodes_mm"]) == 19
    assert scene["duration_s"] == pytest.approx(6.0)
    assert max(scene["overview_n"]) == pytest.approx(np.linalg.norm([0.1, 0.2, 1.0]) * 499 / 200, rel=1e-2)

"""Files and streams for other tools, each opened again by its own reader."""

import json
import struct
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
import pytest
from mcap.reader import make_reader
from rerun.chunk import RrdReader
from websockets.sync.client import connect

from taxel.channels import CHANNELS
from taxel.errors import SettingsError
from taxel_watch.outputs.foxglove_output import foxglove_server, mcap_file, turn_to
from taxel_watch.outputs.output import (
    electrode_colours,
    electrodes_m,
    of_whole,
    write_all,
    write_as_it_comes,
)
from taxel_watch.outputs.rerun_output import TIMELINE, rerun_file
from taxel_watch.replay import Replay

ROWS = 600


def test_all_moments_are_written_once(paced: Replay) -> None:
    times = np.concatenate([update.fingers["1"].time_s for update in of_whole(paced)])
    np.testing.assert_allclose(times, 0.01 * np.arange(ROWS))


def test_an_mcap_file_holds_the_recording(paced: Replay, tmp_path: Path) -> None:
    path = tmp_path / "two.mcap"
    output = mcap_file(path)
    write_all(paced.scene(), of_whole(paced), output)
    output.close()
    with path.open("rb") as file:
        reader = make_reader(file)
        messages = [
            (message.log_time, json.loads(message.data))
            for _, _, message in reader.iter_messages(topics=["/left/index/signals"])
        ]
        skins = list(reader.iter_messages(topics=["/left/index/skin"]))
    recording = paced.recordings[1]
    assert [at for at, _ in messages] == [10_000_000 * row for row in range(ROWS)]
    measured = [[message["measured"][name] for name in CHANNELS] for _, message in messages]
    np.testing.assert_allclose(measured, recording.channels)
    force = [[message["force_n"][axis] for axis in "xyz"] for _, message in messages]
    np.testing.assert_allclose(force, recording.samples.force)
    assert "predicted" not in messages[5][1]
    np.testing.assert_allclose(
        list(messages[50][1]["predicted"].values()), recording.channels[50] - 60, atol=1e-9
    )
    assert len(skins) == ROWS / 3
    schema = skins[0][0]
    assert schema is not None
    assert schema.name == "foxglove.SceneUpdate"


def test_a_rerun_file_holds_the_recording(paced: Replay, tmp_path: Path) -> None:
    path = tmp_path / "two.rrd"
    output = rerun_file(path)
    write_all(paced.scene(), of_whole(paced), output)
    output.close()
    found: dict[str, list[tuple[float, Any]]] = {}
    for chunk in RrdReader(path).stream():
        if not chunk.is_static and TIMELINE in chunk.timeline_names:
            columns = chunk.to_record_batch().to_pydict()
            (component,) = [name for name in columns if name.endswith(("scalars", "colors", "vectors"))]
            times = [moment.total_seconds() for moment in columns[TIMELINE]]
            found.setdefault(chunk.entity_path, []).extend(zip(times, columns[component], strict=True))
    recording = paced.recordings[0]
    times, measured = zip(*sorted(found["/left/thumb/measured"]), strict=True)
    np.testing.assert_allclose(times, 0.01 * np.arange(ROWS), atol=1e-9)
    np.testing.assert_allclose(measured, recording.channels)
    corrected = [values for _, values in sorted(found["/left/index/corrected"])]
    np.testing.assert_allclose(corrected, paced.recordings[1].channels - 8)
    (_, colours), *_ = sorted(found["/left/thumb/electrodes"])[450:]
    rgb = (np.array(colours)[:, None] >> np.array([24, 16, 8])) & 255
    finger = paced.scene().fingers[0]
    np.testing.assert_array_equal(rgb, electrode_colours(finger, paced.blocks(450, 1)["0"])[0])


def test_a_file_is_never_overwritten(tmp_path: Path) -> None:
    for make, name in ((mcap_file, "a.mcap"), (rerun_file, "a.rrd")):
        path = tmp_path / name
        path.write_text("mine")
        with pytest.raises(SettingsError, match="expected the name of a new file"):
            make(path)
        assert path.read_text() == "mine"


def test_foxglove_gets_topics_and_moments(paced: Replay, clock: Any) -> None:
    output, address = foxglove_server("127.0.0.1", 0)
    write_all(paced.scene(), [next(of_whole(paced))], output)
    with connect(address, subprotocols=["foxglove.sdk.v1"]) as app:  # type: ignore[list-item]
        topics: dict[str, int] = {}
        while len(topics) < 4:
            message = app.recv(timeout=20)
            if isinstance(message, str) and (told := json.loads(message))["op"] == "advertise":
                topics |= {channel["topic"]: channel["id"] for channel in told["channels"]}
        assert set(topics) == {f"/left/{f}/{t}" for f in ("thumb", "index") for t in ("signals", "skin")}
        wanted = {"id": 7, "channelId": topics["/left/index/signals"]}
        player = paced.player()
        clock.now += 3.0
        # The subscription is made at some moment: both come again until the update is heard.
        for _ in range(200):
            app.send(json.dumps({"op": "subscribe", "subscriptions": [wanted]}))
            player.command("seek", 3.0)
            write_as_it_comes(player, output, seconds=0.01)
            try:
                message = app.recv(timeout=0.1)
            except TimeoutError:
                continue
            if isinstance(message, bytes) and message[0] == 1:
                break
        assert isinstance(message, bytes)
        code, subscription, _ = struct.unpack("<BIQ", message[:13])
        assert (code, subscription) == (1, 7)
        told = json.loads(message[13:])
        assert set(told) >= {"position_m", "force_n", "measured"}
        assert set(told["measured"]) == set(CHANNELS)
    output.close()


def test_a_port_in_use_is_named() -> None:
    server = foxglove.start_server(name="other", port=0, context=foxglove.Context())
    try:
        with pytest.raises(SettingsError, match=f"cannot listen on 127.0.0.1:{server.port}"):
            foxglove_server("127.0.0.1", server.port)
    finally:
        server.stop()


@pytest.mark.parametrize("direction", [[1, 0, 0], [-1, 0, 0], [0, 0, 2], [0.3, -0.5, 0.1], [0, 0, 0]])
def test_an_arrow_points_along_the_force(direction: list[float]) -> None:
    x, y, z, w = turn_to(np.array(direction, float)).values()
    # The first column of the quaternion's rotation matrix: where +x goes.
    pointed = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
    length = np.linalg.norm(direction)
    np.testing.assert_allclose(pointed, np.array(direction) / length if length else [1, 0, 0], atol=1e-9)


def test_electrodes_lie_on_the_skin() -> None:
    places = electrodes_m()
    away = places.copy()
    away[:, 0] = np.maximum(away[:, 0], 0)
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 0.007)

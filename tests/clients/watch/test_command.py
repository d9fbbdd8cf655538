"""`taxel watch` as it is typed: each source, and what it says of bad use."""

import json
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from typer.testing import CliRunner
from websockets.sync.client import connect

import taxel
from taxel.commands.cli import build
from taxel.local import shipped_repository
from taxel_bench.server_process import running_server
from taxel_models.recordings import write_ruppel
from taxel_models.twin import simulate


def told(*arguments: str | Path) -> tuple[int, str]:
    """The exit code and the error text of a command that ends at once."""
    done = CliRunner().invoke(build(), ["watch", *map(str, arguments)])
    return done.exit_code, " ".join(done.output.split())


@contextmanager
def watching(*arguments: str | Path) -> Iterator[str]:
    """The address that `taxel watch --json` prints; it ends cleanly when it is told to."""
    command = [sys.executable, "-m", "taxel", "watch", *map(str, arguments), "--json", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = process.stdout.readline()
    try:
        assert line, process.communicate()[1]
        yield json.loads(line)["address"]
    finally:
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")


def messages(address: str) -> Iterator[dict[str, Any]]:
    """What a page that draws everything at once gets."""
    with connect(address.replace("http", "ws") + "stream") as page:
        while True:
            message = json.loads(page.recv(timeout=60))
            if message["type"] == "frame":
                page.send(json.dumps({"name": "drawn", "value": message["number"]}))
            yield message


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "hand" / "thumb.csv"
    path.parent.mkdir()
    write_ruppel(simulate(300, 5), path)
    return path


def test_the_demo_serves_its_page_and_moves() -> None:
    with watching("--demo") as address:
        place = urlsplit(address)
        assert place.hostname == "127.0.0.1"
        page = HTTPConnection(place.hostname, place.port, timeout=30)
        page.request("GET", "/")
        assert page.getresponse().status == 200
        page.close()
        frames = [message for message in messages_until(address, 10) if message["type"] == "frame"]
        assert frames[-1]["at_s"] > frames[0]["at_s"]
        assert set(frames[0]["fingers"]) == {"0", "1", "2"}


def messages_until(address: str, frames: int) -> list[dict[str, Any]]:
    found = []
    for message in messages(address):
        found.append(message)
        if sum(each["type"] == "frame" for each in found) == frames:
            break
    return found


def test_a_recording_is_replayed_with_a_models_predictions(recording: Path, tmp_path: Path) -> None:
    repository = tmp_path / "repository"
    shutil.copytree(shipped_repository() / "network-b", repository / "network-b")
    with watching(recording, "--model", "network-b", "--repository", repository) as address:
        for message in messages(address):
            if message["type"] == "scene" and "predicted" in message["traces"]:
                break
            assert not str(message.get("note", "")).startswith("no prediction")
        assert message["traces"] == {"measured": "", "predicted": "network-b/1"}
        assert message["fingers"][0]["hand"] == "hand"
        assert message["fingers"][0]["label"] == "thumb"
        assert message["title"] == str(recording)


def test_a_models_name_that_is_wrong_is_told_on_the_page(recording: Path) -> None:
    with watching(recording, "--model", "nosuch") as address:
        for message in messages(address):
            if str(message.get("note", "")).startswith("no prediction"):
                break
        assert "no model 'nosuch'; there is: " in message["note"]


def test_the_traffic_of_a_server_process_is_shown(tmp_path: Path) -> None:
    shutil.copytree(shipped_repository() / "network-b", tmp_path / "network-b")
    with running_server(tmp_path, "--watchable") as endpoint, taxel.connect(endpoint) as source:
        predictor = source.predictor("network-b")
        assert predictor.transport == "lane"
        fingers = predictor.fingers(2)
        with watching("--connect", endpoint) as address:
            force = 0.0
            for message in messages(address):
                force += 0.01
                channels = fingers.step(
                    np.tile([-0.004, 0, -0.007], (2, 1)), np.tile([0, 0, force], (2, 1))
                )
                shown = message["fingers"].values() if message["type"] == "frame" else ()
                if len(shown) == 2 and min(finger["force_n"][0][2] for finger in shown) > 0:
                    break
            (first, second) = shown
            assert first["force_n"] == second["force_n"]
            assert first["force_n"][0][2] < force + 0.01
            assert np.abs(np.array(first["counts"]["predicted"][0]) - channels[0]).max() < 500


def test_bad_use_is_told(tmp_path: Path, recording: Path) -> None:
    assert told() == (2, "error: expected one of: RECORDING …, --demo, or --connect ENDPOINT alone")
    assert told(recording, "--demo")[0] == 2
    assert told(recording, "--corrected", "mine/2") == (
        2,
        "error: --corrected: expected --model as well, the version that it corrects",
    )
    assert told("--connect", "tcp/127.0.0.1:7", "--model", "xgb")[0] == 2
    assert told("--demo", "--terminal", "--mcap", "a.mcap")[0] == 2
    code, text = told(tmp_path / "none.csv")
    assert code == 1
    assert "none.csv: does not exist; expected a Ruppel CSV file" in text


def test_recordings_that_cannot_be_replayed_are_named(tmp_path: Path) -> None:
    contacts = tmp_path / "contacts.csv"
    contacts.write_text("%time,field.position.x\n0,1\n")
    assert "has no measured channels; expected a recording" in told(contacts)[1]
    damaged = tmp_path / "damaged.csv"
    damaged.write_text("%time,field.tactiles0.pdc\nnever,1\n")
    code, text = told(damaged)
    assert (code, "damaged.csv" in text) == (1, True)


def test_a_port_in_use_is_told(recording: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, text = told(recording, "--no-open", "--port", str(port))
    assert code == 2
    assert f"cannot listen on 127.0.0.1:{port}" in text
    assert "expected a free port" in text


@pytest.mark.parametrize(
    ("arguments", "package", "extra"),
    [
        ([], "websockets", "watch"),
        (["--mcap", "a"], "foxglove", "foxglove"),
        (["--rerun", "a"], "rerun", "rerun"),
    ],
)
def test_a_missing_package_names_its_extra(
    recording: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], package: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    code, text = told(recording, *arguments)
    assert code == 1
    assert f"needs {package}: pip install 'taxel[{extra}]'" in text


def test_files_for_other_tools_are_written_at_once(recording: Path, tmp_path: Path) -> None:
    for option, name in (("--mcap", "a.mcap"), ("--rerun", "a.rrd")):
        code, text = told(recording, option, tmp_path / name)
        assert (code, text.startswith("Wrote")) == (0, True)
        assert (tmp_path / name).stat().st_size > 10_000

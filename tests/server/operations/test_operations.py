"""A server as an operator sees it: metrics, health, log, service manager, reload, and the commands."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest
from numpy.typing import NDArray
from prometheus_client.openmetrics.parser import text_string_to_metric_families as open_metrics
from prometheus_client.parser import text_string_to_metric_families as plain_text
from typer.testing import CliRunner, Result

import taxel
from taxel.commands.cli import build
from taxel.commands.top import compared
from taxel.errors import InvalidArgument
from taxel.protocol import pack_infer_request
from taxel_server.core.statistics import Histogram
from taxel_server.engine import Engine

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]

HANG_S = 60


class Manager:
    """The end of the service manager."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self.socket.settimeout(HANG_S)

    def wait_for(self, state: str) -> None:
        while state not in self.socket.recv(4096).decode().split("\n"):
            pass


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    made = Manager(tmp_path / "notify")
    with made.socket:
        yield made


@pytest.fixture
def own_repository(repository: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(repository, tmp_path / "repository"))


@pytest.fixture
def process(
    own_repository: Path, endpoint: str, engine: Engine, manager: Manager, tmp_path: Path
) -> Iterator[subprocess.Popen[str]]:
    """A server under a service manager. `engine` has loaded the same models: nothing is compiled."""
    command = ["serve", "--repository", own_repository, "--listen", endpoint, "--http", "127.0.0.1:0"]
    with subprocess.Popen(
        [sys.executable, "-m", "taxel", *map(str, command), "--json", "--log-format", "json"],
        cwd=tmp_path,
        env=os.environ | {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "500000"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as server:
        yield server
        server.kill()


def get(address: str, path: str, **headers: str) -> str:
    with urlopen(Request(f"http://{address}{path}", headers=headers), timeout=HANG_S) as answer:
        content: bytes = answer.read()
    return content.decode()


def samples(text: str, parse: Callable[[str], Any] = plain_text) -> dict[tuple[str, ...], float]:
    """Every sample by its name and its labels' values, in the order of the labels' names."""
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in parse(text)
        for sample in family.samples
    }


def check_with_promtool(text: str) -> None:
    """Where Prometheus is installed, its own tool reads the text."""
    if (promtool := shutil.which("promtool")) is None:
        return
    subprocess.run([promtool, "check", "metrics"], input=text, text=True, check=True, capture_output=True)


def test_a_server_under_a_service_manager(
    process: subprocess.Popen[str],
    manager: Manager,
    endpoint: str,
    own_repository: Path,
    make_artifact: Callable[..., Path],
    make_windows: WindowMaker,
) -> None:
    address = json.loads(process.stdout.readline())["http"]
    manager.wait_for("READY=1")
    manager.wait_for("WATCHDOG=1")
    assert json.loads(get(address, "/v2/health/live")) == {"live": True}
    assert json.loads(get(address, "/v2/health/ready")) == {"ready": True}
    with pytest.raises(HTTPError, match="404"):
        get(address, "/v2/models/skin/infer")

    with taxel.connect(endpoint, transport="zenoh") as client:
        predictor = client.predictor("skin")
        for _ in range(5):
            predictor.predict(make_windows(3))
        for request in ("touch 1", "touch 2"):
            wrong = pack_infer_request(make_windows(1, 7), request_id=request)
            with pytest.raises(InvalidArgument):
                client.get("taxel/v2/models/skin/infer", wrong)
        text = get(address, "/metrics")
        check_with_promtool(text)
        found = samples(text)
        assert found["taxel_ready",] == 1
        assert found["taxel_rows_total", "skin", "10"] == 15
        assert found["taxel_requests_total", "skin", "10"] == 7
        assert found["taxel_errors_total", "zenoh", "INVALID_ARGUMENT"] == 2
        assert found["taxel_version_loads_total", "loaded"] == 3
        assert found["taxel_connections", "zenoh"] == 1
        assert found["process_resident_memory_bytes",] > 2**20
        if sys.platform == "linux":
            assert 0 <= found["taxel_worker_run_delay_seconds_total",] < found["taxel_uptime_seconds",]
        assert samples(get(address, "/metrics", Accept="application/openmetrics-text"), open_metrics)

        make_artifact(own_repository, "skin", "11")
        process.send_signal(signal.SIGHUP)
        manager.wait_for("RELOADING=1")
        manager.wait_for("READY=1")
        assert client.predictor("skin").manifest.version == "11"
        # A predictor keeps the version that it was made for.
        assert predictor.predict(make_windows(3)).shape == (3, 21)
        assert client.get("taxel/v2/models/skin/infer", pack_infer_request(make_windows(1)))

    process.terminate()
    manager.wait_for("STOPPING=1")
    assert process.wait(HANG_S) == 0
    lines = [json.loads(line) for line in process.stderr.read().splitlines()]
    refused = [line for line in lines if line["logger"] == "taxel_server.refusals"]
    assert [(line["code"], line["client"], line["request_id"]) for line in refused] == [
        ("INVALID_ARGUMENT", "zenoh", "touch 1")
    ]


def test_histograms_agree_with_their_definition() -> None:
    from taxel_server.operations.metrics import _TIME_POWERS, _buckets

    values = [0, 1, 7, 8, 9, 100, 5_000, 10**8]
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    buckets, total = _buckets(histogram.as_dict(), _TIME_POWERS, 1e-6)
    assert total == pytest.approx(sum(values) * 1e-6)
    for end, count in buckets:
        assert count == sum(value * 1e-6 <= float(end) * (1 + 1e-9) for value in values)


def test_top_shows_what_happened_between_two_looks() -> None:
    def looked(requests: int, times: list[int], delay: float | None = None, **more: Any) -> dict[str, Any]:
        histogram = Histogram()
        for value in times:
            histogram.add(value)
        told = histogram.as_dict()
        model = {"name": "skin", "version": "1", "requests": requests, "rows": 2 * requests, "errors": {}}
        return {
            **dict.fromkeys(("uptime_s", "queue", "connections", "refusals", "loads", "resident_bytes"), 0),
            "run_delay_s": delay,
            "models": [model | more | {"queue_us": told, "compute_us": told, "batch_rows": told}],
        }

    after = looked(30, [900] * 10 + [30] * 19 + [60], cancelled={"requests": 6, "rows": 90})
    (shown,) = compared(looked(10, [900] * 10), after, 2.0)["models"]
    assert (shown["requests_per_s"], shown["rows_per_s"], shown["cancelled_per_s"]) == (10, 20, 3)
    assert (shown["queue_us_p50"], shown["queue_us_p99"]) == (32, 64)
    waited = [
        compared(looked(1, [], before), looked(2, [], now), 2.0)["waited_for_core"]
        for before, now in ((1.0, 1.5), (None, 1.5), (None, None))
    ]
    assert waited == [0.25, None, None]


@pytest.fixture(scope="module")
def run() -> Callable[..., Result]:
    app = build()
    return lambda *arguments: CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_check_says_whether_a_loop_fits(
    run: Callable[..., Result], start_module: ServerStarter, engine: Engine
) -> None:
    place = start_module(engine)
    slow = run("check", place, "--model", "skin", "--rate", 100, "--seconds", 0.2, "--late", 1, "--json")
    assert slow.exit_code == 0, slow.output
    told = json.loads(slow.stdout)
    assert (told["steps"], told["fits"], told["model"], told["version"]) == (20, True, "skin", "10")
    assert told["round_trip_us"]["p50"] >= told["server_compute_us"]["p50"] > 0
    # No loop of 50 µs fits, as Python alone takes as long.
    fast = run("check", place, "--model", "skin", "--rate", 20_000, "--seconds", 0.2, "--late", 0)
    assert fast.exit_code == 1
    assert "the loop does not fit" in fast.stdout
    missing = run("check", place, "--model", "none", "--seconds", 0.2)
    assert missing.exit_code == 1
    assert "no model 'none'" in missing.stderr

    top = run("top", place, "--every", 0.1, "--json")
    assert top.exit_code == 0, top.output
    models = json.loads(top.stdout)["models"]
    assert [model["model"] for model in models] == ["skin/2", "skin/10", "wide/1"]
    assert "skin/10" in run("top", place, "--every", 0.1, "--once").stdout


def test_the_doctor_finds_who_listens(run: Callable[..., Result]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        result = run("doctor", "--port", port, "--json")
        assert result.exit_code == 1
        findings = {finding["subject"]: finding for finding in json.loads(result.stdout)["findings"]}
    assert {
        "Python",
        "packages",
        "processor",
        "cores",
        "clock",
        "timer",
        "files",
        "lane",
    } <= findings.keys()
    assert str(os.getpid()) in findings[f"port {port}"]["found"]
    assert all(finding["remedy"] for finding in findings.values() if finding["grade"] != "good")
    assert "✓ Python" in run("doctor", "--port", port).stdout

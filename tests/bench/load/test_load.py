"""Load on real server processes, from real client processes."""

import json
import multiprocessing
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from typer.testing import CliRunner

import taxel
from taxel.commands.cli import failing_clearly, new_app
from taxel.errors import TaxelError, Unavailable
from taxel_bench.load.clients import ready_clients
from taxel_bench.load.command import load
from taxel_bench.load.drive import drive
from taxel_bench.load.results import Results
from taxel_bench.load.settings import LoadSettings, Scenario
from taxel_bench.load.usage import ServerUsage
from taxel_bench.server_process import running_server

SENT = {
    "single-stream": ["--queries", "70", "--clients", "2"],
    "multi-stream": ["--queries", "50", "--samples-per-query", "5"],
    "server": ["--queries", "120", "--rate", "400", "--clients", "2"],
    "offline": ["--queries", "24"],
}
SAMPLES = {"single-stream": 1, "multi-stream": 5, "server": 1, "offline": 1024}


def run(*arguments: str) -> Any:
    app = new_app("test")
    app.command()(failing_clearly(load))
    return CliRunner().invoke(app, list(arguments))


def test_the_lane_is_driven_with_pauses(endpoint: str) -> None:
    arguments = ("--scenario", "single-stream", "--model", "xgb", "--connect", endpoint, "--queries", "70")
    done = run(*arguments, "--server", "taxel-lane", "--gap-ms", "0,1.5", "--json")
    assert done.exit_code == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["scenario"]["server"], told["results"]["answered"]) == ("taxel-lane", 70)
    assert told["gaps"]["0"]["p50_ms"] == told["results"]["latency_ms"]["p50"]
    assert told["gaps"]["1.5"]["p50_ms"] > 0
    done = run("--scenario", "offline", "--model", "xgb", "--connect", endpoint, "--gap-ms", "0,1")
    assert "expected single-stream or multi-stream" in done.stderr


@pytest.mark.parametrize("scenario", SENT)
def test_each_scenario_accounts_for_every_query(endpoint: str, scenario: Scenario) -> None:
    done = run("--scenario", scenario, "--model", "xgb", "--connect", endpoint, "--json", *SENT[scenario])
    assert done.exit_code == 0, done.stderr
    told = json.loads(done.stdout)
    assert set(told) == {"machine", "scenario", "results", "gaps"}
    asked, results = told["scenario"], told["results"]
    assert set(results) == set(Results.__annotations__)
    assert (asked["scenario"], asked["model"], asked["version"]) == (scenario, "xgb", "1")
    sent, samples = int(SENT[scenario][1]), SAMPLES[scenario]
    assert (results["sent"], results["answered"], results["errors"]) == (sent, sent, {})
    assert results["batches"]["rows"] == sent * samples
    assert sum(results["batch_rows"].values()) == results["batches"]["count"] <= sent
    # So short a run may take less than a tick of the processor clock.
    assert results["server_cpu_us"] >= 0
    assert results["clients_cpu_us"] > 0
    # What the server says of its own part fits into the whole.
    assert results["compute_ms"]["max"] < results["latency_ms"]["max"]
    assert results["latency_ms"]["p50"] > results["queue_ms"]["p50"]
    few = [reason for reason in results["reasons"] if "do not support" in reason]
    assert bool(few) == (scenario in ("multi-stream", "server"))
    assert results["verdict"] == ("INVALID" if results["reasons"] else "VALID")


def test_the_table_says_why_a_run_is_invalid(endpoint: str) -> None:
    done = run("--scenario", "server", "--model", "xgb", "--connect", endpoint, "--queries", "20")
    assert done.exit_code == 0, done.stderr
    assert "server, xgb/1, 1 client, 1 sample a query, 500 queries/s: INVALID" in done.stdout
    assert "20 queries do not support p99: at least 662 are needed" in done.stdout
    assert "20 sent = 20 answered + 0 errors" in done.stdout


def test_streams_last_as_long_as_told(endpoint: str) -> None:
    settings = LoadSettings.of("single-stream", "network-b", duration_s=0.3)
    records = drive(settings, endpoint).records
    assert len(records) > 1
    assert records["sent"].max() < 0.3
    assert (records["sent"][1:] >= records["answered"][:-1]).all()


def test_arrivals_do_not_wait_for_answers(endpoint: str) -> None:
    """At a rate far above what can be answered, queries are due and sent while others are in flight."""
    outcome = drive(LoadSettings.of("server", "xgb", queries=500, rate_qps=50_000.0), endpoint)
    records = outcome.records
    assert len(records) == 500
    assert (records["sent"] >= records["scheduled"]).all()
    assert (records["sent"][1:] < records["answered"][:-1]).any()
    assert outcome.server.batches < 500


def test_a_queue_that_is_full_is_counted_as_errors(endpoint: str) -> None:
    """More samples at once than the server's queue takes."""
    settings = LoadSettings.of("offline", "xgb", queries=4, samples_per_query=60_000)
    found = Results.of(settings, drive(settings, endpoint))
    assert found.sent == 4 == found.answered + sum(found.errors.values())
    assert set(found.errors) == {"RESOURCE_EXHAUSTED"}
    assert found.verdict == "INVALID"


def test_without_a_server_one_is_started_and_stopped(small_repository: Path) -> None:
    before = psutil.Process().children()
    served = ["--model", "network-b", "--repository", str(small_repository)]
    done = run("--scenario", "single-stream", *served, "--queries", "20", "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["results"]["answered"] == 20
    left = [child for child in psutil.Process().children() if child not in before]
    assert not [child for child in left if "serve" in child.cmdline()]


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        (["--model", "nobody"], 1, "no model 'nobody'"),
        (["--model", "xgb", "--connect", "tcp/127.0.0.1:1", "--timeout", "0.2"], 1, "no server at"),
        (["--model", "xgb", "--connect", "nonsense"], 1, "expected PROTOCOL/ADDRESS"),
        (["--model", "xgb", "--queries", "1", "--duration", "1"], 2, "expected one of the two"),
    ],
)
def test_what_cannot_be_run_is_told(endpoint: str, options: list[str], code: int, text: str) -> None:
    done = run("--scenario", "server", "--connect", endpoint, *options)
    assert done.exit_code == code
    assert text in " ".join(done.stderr.split())
    assert done.stdout == ""


def test_a_client_process_that_dies_is_told(endpoint: str) -> None:
    with (
        pytest.raises(TaxelError, match="client process 0 ended before its work was done, with code -9"),
        ready_clients(LoadSettings.of("single-stream", "xgb"), endpoint) as clients,
    ):
        (client,) = multiprocessing.active_children()
        client.kill()
        clients.run()


def test_interrupted_it_leaves_no_process(endpoint: str) -> None:
    """Ctrl-C reaches the whole group; nothing but one line is said."""
    program = (
        "from taxel.commands.cli import failing_clearly\n"
        "from taxel_bench.load.command import load\n"
        "import signal\n"
        "import typer\n"
        "if __name__ == '__main__':\n"
        # What starts the tests may have told its children to ignore interrupts.
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "    typer.run(failing_clearly(load))\n"
    )
    arguments = ["--scenario", "single-stream", "--model", "xgb", "--connect", endpoint, "--clients", "2"]
    process = subprocess.Popen(
        [sys.executable, "-c", program, *arguments, "--duration", "60"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    _wait_for_load(endpoint, "xgb")
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) >= 2
    psutil.Process(process.pid).send_signal(signal.SIGINT)
    for child in children:
        # Its parent may have ended it already.
        with suppress(psutil.NoSuchProcess):
            child.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=30)
    assert (process.returncode, output) == (130, "")
    assert errors.splitlines() == ["measuring …", "interrupted"]
    _, alive = psutil.wait_procs(children, timeout=5)
    assert alive == []


@pytest.mark.parametrize("scenario", ["single-stream", "server"])
def test_a_server_that_dies_during_the_run_is_told(scenario: Scenario, small_repository: Path) -> None:
    others = set(psutil.Process().children())
    with running_server(small_repository) as doomed, ThreadPoolExecutor(1) as pool:
        (server,) = set(psutil.Process().children()) - others

        def kill_under_load() -> None:
            _wait_for_load(doomed, "network-b")
            server.kill()

        killing = pool.submit(kill_under_load)
        with pytest.raises(Unavailable, match="stopped answering"):
            drive(LoadSettings.of(scenario, "network-b", duration_s=30.0, timeout_s=5.0), doomed)
        killing.result()


def _wait_for_load(endpoint: str, model: str) -> None:
    """Return when queries of a run are being answered, after the warm-up."""
    with taxel.connect(endpoint, timeout=30) as source:
        manifest = source.predictor(model).manifest
        begun = ServerUsage.now(source, manifest).requests
        ends = time.monotonic() + 20
        while ServerUsage.now(source, manifest).requests < begun + 100:
            assert time.monotonic() < ends, "no load came"
            time.sleep(0.02)

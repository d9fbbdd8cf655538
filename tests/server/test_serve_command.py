"""`taxel serve` as a process of its own: starting, refusing to start, stopping."""

import json
import os
import resource
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray

import taxel
from taxel.errors import Unavailable
from taxel.protocol import pack_infer_request, unpack_error, unpack_infer_response
from taxel_bench.plain_client import client_config
from taxel_server.engine import Engine
from taxel_server.processor import most_open_files

WindowMaker = Callable[..., NDArray[np.float32]]
Starter = Callable[..., subprocess.Popen[str]]

HANG_S = 30


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Starter]:
    """Starts `taxel serve` in an empty folder."""
    processes = []

    def serve(*arguments: Any) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "taxel", "serve", *map(str, arguments)],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        return process

    yield serve
    for process in processes:
        process.kill()
        process.communicate()


@pytest.fixture
def serving(
    run: Starter, repository: Path, endpoint: str, engine: Engine
) -> Callable[..., subprocess.Popen[str]]:
    """A server that is ready. `engine` has loaded the same models, so that it need not compile."""
    del engine

    def serve(*arguments: Any) -> subprocess.Popen[str]:
        process = run("--repository", repository, "--listen", endpoint, "--json", *arguments)
        line = process.stdout.readline()
        assert line, process.stderr.read()
        ready = json.loads(line)
        assert ready["listen"] == [endpoint]
        assert [model["name"] for model in ready["models"]] == ["skin", "skin", "wide"]
        return process

    return serve


def test_zenohs_log_goes_to_stderr(serving: Starter, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RUST_LOG", "zenoh=info")
    process = serving()
    process.terminate()
    stdout, stderr = process.communicate(timeout=HANG_S)
    assert stdout == ""
    assert "zenoh" in stderr
    assert "\x1b[" not in stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_told_to_stop(
    serving: Starter, endpoint: str, make_windows: WindowMaker, number: signal.Signals
) -> None:
    process = serving()
    with taxel.connect(endpoint) as client:
        assert client.predictor("skin").predict(make_windows(3)).shape == (3, 21)
        process.send_signal(number)
        assert process.wait(HANG_S) == 0
        with pytest.raises(Unavailable):
            client.models()
    assert process.stderr.read() == ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_under_load_every_query_is_answered(
    serving: Starter, endpoint: str, make_windows: WindowMaker, engine: Any, number: signal.Signals
) -> None:
    """With a full queue and no time to drain it, what is not predicted is refused, and nothing is lost."""
    process = serving("--drain-seconds", "0.05", "--max-batch-rows", "256", "--max-queue-rows", "400000")
    windows = make_windows(4096, 12)
    expected = engine.model("wide").evaluate(windows)
    request = pack_infer_request(windows)
    with zenoh.open(client_config(endpoint)) as session:
        key = "taxel/v2/models/wide/infer"
        asked = [session.get(key, payload=request, timeout=HANG_S) for _ in range(30)]
        # Queries of one session arrive in order: this one's answer says that all others are there.
        assert next(iter(session.get("taxel/v2/health/live", timeout=HANG_S))).ok
        process.send_signal(number)
        answers = [list(replies) for replies in asked]
        assert process.wait(HANG_S) == 0
    assert [len(answer) for answer in answers] == [1] * 30
    for (reply,) in answers:
        if reply.ok is not None:
            predicted = unpack_infer_response(reply.ok.payload.to_bytes()).outputs
            np.testing.assert_array_equal(predicted, expected)
        else:
            assert isinstance(unpack_error(reply.err.payload.to_bytes()), Unavailable)


def test_a_client_of_a_killed_server_is_told(
    serving: Starter, endpoint: str, make_windows: WindowMaker
) -> None:
    process = serving()
    with taxel.connect(endpoint) as client, ThreadPoolExecutor(1) as pool:
        predictor = client.predictor("wide")
        predictor.predict(make_windows(1, 12))

        def ask_on() -> None:
            while True:
                predictor.predict(make_windows(2000, 12), timeout=HANG_S)

        asking = pool.submit(ask_on)
        process.kill()
        with pytest.raises(Unavailable):
            asking.result(HANG_S)


def test_a_stuck_client_does_not_keep_it(
    serving: Starter, endpoint: str, make_windows: WindowMaker
) -> None:
    """A client that asks for much, reads nothing and never leaves holds up neither others nor the end."""
    process = serving()
    asks = (
        "import sys, os, signal, taxel, numpy\n"
        "from taxel.protocol import pack_infer_request\n"
        "source = taxel.connect(sys.argv[1])\n"
        "request = pack_infer_request(numpy.zeros((3000, 6), numpy.float32))\n"
        "key = 'taxel/v2/models/skin/infer'\n"
        "asked = [source.connection.start(key, request, 60.0) for _ in range(40)]\n"
        "print('asked', flush=True)\n"
        "os.kill(os.getpid(), signal.SIGSTOP)\n"
    )
    stuck = subprocess.Popen([sys.executable, "-c", asks, endpoint], stdout=subprocess.PIPE, text=True)
    try:
        assert stuck.stdout.readline() == "asked\n"
        with taxel.connect(endpoint) as client:
            assert client.predictor("skin").predict(make_windows(3), timeout=HANG_S).shape == (3, 21)
        process.terminate()
        assert process.wait(HANG_S) == 0
    finally:
        stuck.kill()
        stuck.communicate()


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (("--repository", "nowhere"), 1, "nowhere: no such folder"),
        (("--repository", "."), 1, "no model that can be served; the folder holds none"),
        (("--repository", ".", "--max-batch-rows", "0"), 2, "max_batch_rows"),
        (("--repository", ".", "--listen", "localhost"), 2, "expected PROTOCOL/ADDRESS"),
    ],
)
def test_it_does_not_start_without_something_to_serve(
    run: Starter, arguments: tuple[str, ...], code: int, text: str
) -> None:
    process = run(*arguments)
    output, errors = process.communicate(timeout=HANG_S)
    assert (process.returncode, output) == (code, "")
    assert text in errors


def test_only_damaged_models_are_told_with_their_reasons(
    run: Starter, tmp_path: Path, make_artifact: Callable[..., Path]
) -> None:
    (make_artifact(tmp_path, "torn", "1") / "model.json").unlink()
    process = run("--repository", tmp_path)
    _, errors = process.communicate(timeout=HANG_S)
    assert process.returncode == 1
    assert "no model that can be served" in errors
    assert "model.json: No such file" in errors


def test_without_a_repository_it_serves_what_comes_with_taxel(run: Starter, endpoint: str) -> None:
    process = run("--listen", endpoint, "--json")
    line = process.stdout.readline()
    assert line, process.stderr.read()
    with taxel.load() as shipped:
        assert [model["name"] for model in json.loads(line)["models"]] == [
            model.name for model in shipped.models()
        ]


def test_in_a_narrow_terminal_no_name_is_cut_off(run: Starter, endpoint: str) -> None:
    process = run("--listen", endpoint, "--json")
    served = json.loads(process.stdout.readline())["models"]
    listed = subprocess.run(
        [sys.executable, "-m", "taxel", "models", "--connect", endpoint],
        env=os.environ | {"COLUMNS": "80"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert "…" not in listed
    lines = [line.partition(": ")[::2] for line in listed.splitlines()]
    for model in served:
        assert f"{model['name']}/{model['version']}" in listed
        evaluated = (
            f"one row by {model['one_row']}, many by {model['many_rows']} ({model['instruction_set']})"
        )
        assert any(f"{model['name']}/{model['version']}" in users for by, users in lines if by == evaluated)


def test_an_occupied_port_is_told(serving: Starter, run: Starter, repository: Path, endpoint: str) -> None:
    serving()
    second = run("--repository", repository, "--listen", endpoint)
    _, errors = second.communicate(timeout=HANG_S)
    assert second.returncode == 1
    assert f"cannot listen on {endpoint}" in errors


def test_it_tells_people_what_it_serves(run: Starter, repository: Path, endpoint: str) -> None:
    process = run("--repository", repository, "--listen", endpoint)
    lines = []
    while not lines or "listening" not in lines[-1]:
        lines.append(process.stdout.readline())
        assert lines[-1], process.stderr.read()
    assert lines[-1] == f"listening on {endpoint}\n"
    assert sum("READY" in line for line in lines) == 3


def limited(endpoint: str, repository: Path, limit: str) -> subprocess.Popen[str]:
    """A server that a shell starts with limits of open files, as `ulimit` takes them."""
    command = shlex.join([sys.executable, "-m", "taxel", "serve", "--repository", str(repository)])
    return subprocess.Popen(
        ["sh", "-c", f"{limit} && exec {command} --listen {endpoint} --json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_too_few_open_files_are_told(repository: Path, endpoint: str) -> None:
    process = limited(endpoint, repository, "ulimit -n 20")
    output, errors = process.communicate(timeout=HANG_S)
    assert (process.returncode, output) == (2, "")
    assert "this process may open 20 files: expected 64" in errors


def test_it_opens_as_many_files_as_it_may(repository: Path, endpoint: str, engine: Engine) -> None:
    """Shells give 1,024, or 256 on macOS; clients of a fleet take more."""
    del engine
    process = limited(endpoint, repository, "ulimit -S -n 100")
    assert process.stdout is not None
    try:
        assert json.loads(process.stdout.readline())["listen"] == [endpoint]
        assert resource.prlimit(process.pid, resource.RLIMIT_NOFILE)[0] == most_open_files()
    finally:
        process.kill()
        process.communicate()


def wait_until_it_serves(endpoint: str, process: subprocess.Popen[str]) -> None:
    """For a server that says nowhere when it is ready."""
    host, port = endpoint.removeprefix("tcp/").split(":")
    ends = time.monotonic() + HANG_S
    while True:
        try:
            # Where nobody listens, this fails at once.
            socket.create_connection((host, int(port))).close()
            with taxel.connect(endpoint) as client:
                client.models()
        except (ConnectionRefusedError, Unavailable):
            assert process.poll() is None
            assert time.monotonic() < ends
            time.sleep(0.05)
        else:
            return


@pytest.mark.parametrize("stdout", [">&-", "> /dev/full"])
def test_a_stdout_that_takes_nothing_stops_no_server(
    repository: Path, endpoint: str, engine: Engine, make_windows: WindowMaker, stdout: str
) -> None:
    """As behind `| head -1`, or on a full disk."""
    del engine
    command = shlex.join([sys.executable, "-m", "taxel", "serve", "--repository", str(repository)])
    process = subprocess.Popen(
        ["sh", "-c", f"exec {command} --listen {endpoint} {stdout}"], stderr=subprocess.PIPE, text=True
    )
    try:
        wait_until_it_serves(endpoint, process)
        with taxel.connect(endpoint) as client:
            assert client.predictor("skin").predict(make_windows(3)).shape == (3, 21)
        process.terminate()
        _, errors = process.communicate(timeout=HANG_S)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0
    assert ("stdout takes no announcement" in errors) == (stdout == "> /dev/full")
    assert "Traceback" not in errors

"""Programs in processes of their own: obeyed, accounted for, and ended with all that they started."""

import os
import sys
import time

import psutil
import pytest

from taxel.errors import SettingsError, Unavailable
from taxel_bench.compare.processes import Cores, running_program

ECHO = "import json, sys\nfor line in sys.stdin: print(json.dumps({'heard': json.loads(line)}), flush=True)"
PARENT = (
    "import subprocess, sys, time\n"
    "child = subprocess.Popen([sys.executable, '-c', 'while True: pass'])\n"
    "print(child.pid, file=sys.stderr, flush=True)\n"
    "time.sleep(60)"
)


def test_an_order_is_answered() -> None:
    with running_program([sys.executable, "-c", ECHO], takes_requests=True) as program:
        assert program.request(do="sing", times=3) == {"heard": {"do": "sing", "times": 3}}
        assert program.runs
    assert not program.runs


def test_last_words_are_kept() -> None:
    command = [sys.executable, "-c", "raise ValueError('no ink')"]
    with (
        running_program(command, takes_requests=True) as program,
        pytest.raises(Unavailable, match=r"^ValueError: no ink$"),
    ):
        program.request(do="print")


def test_children_are_counted_and_ended() -> None:
    with running_program([sys.executable, "-c", PARENT]) as program:
        while program.cpu_seconds() < 0.5:
            time.sleep(0.05)
        child = psutil.Process(int(program.last_log_line()))
        assert child.is_running()
    assert not child.is_running() or child.status() == psutil.STATUS_ZOMBIE


@pytest.mark.skipif(sys.platform != "linux", reason="keeps processes on cores")
def test_a_program_stays_on_its_cores() -> None:
    core = max(os.sched_getaffinity(0))
    asking = (
        "import json, os, threading\n"
        "found = []\n"
        "thread = threading.Thread(target=lambda: found.extend(os.sched_getaffinity(0)))\n"
        "input(); thread.start(); thread.join()\n"
        "print(json.dumps({'cores': found}), flush=True)"
    )
    command = [sys.executable, "-c", asking]
    with running_program(command, takes_requests=True, cores=frozenset([core])) as program:
        assert program.request() == {"cores": [core]}


@pytest.mark.skipif(sys.platform != "linux", reason="keeps processes on cores")
def test_each_side_gets_cores_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {5, 3, 8})
    assert Cores.apart() == Cores(servers=frozenset([3, 5]), clients=frozenset([8]))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3})
    with pytest.raises(SettingsError, match="--pin: there is one core"):
        Cores.apart()

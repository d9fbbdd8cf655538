"""How a session of zenoh ends, also where zenoh's own end does not come."""

import subprocess
import sys
import threading
import time
from typing import Any

import pytest
import zenoh

from taxel.zenoh_process import close_session, open_session


class EndlessSession:
    """What zenoh is where the other end leaves at the same moment: its close does not return."""

    def __init__(self) -> None:
        self.released = threading.Event()

    def close(self) -> None:
        self.released.wait(60)


class FailingSession:
    """What zenoh is where the other end has stopped reading for ten seconds."""

    def close(self) -> None:
        raise zenoh.ZError("close operation timed out")


def test_a_session_is_closed() -> None:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    session = open_session(config)
    assert close_session(session, patience_s=30.0)
    assert session.is_closed()


def test_a_session_that_does_not_end_is_left_behind() -> None:
    endless: Any = EndlessSession()
    began = time.monotonic()
    assert not close_session(endless, patience_s=0.05)
    assert time.monotonic() - began < 30
    endless.released.set()


@pytest.mark.filterwarnings("error")
def test_an_error_of_the_end_is_nobodys() -> None:
    failing: Any = FailingSession()
    assert close_session(failing)


def test_a_session_is_closed_while_the_interpreter_ends() -> None:
    """Then, Python 3.12 starts no thread any more."""
    program = """
import atexit, zenoh
from taxel.zenoh_process import close_session, open_session
config = zenoh.Config()
config.insert_json5("scouting/multicast/enabled", "false")
session = open_session(config)
atexit.register(lambda: print(close_session(session), session.is_closed()))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("True True\n", "")

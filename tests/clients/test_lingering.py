"""zenoh's connections end at once: no thread of zenoh waits for what a client has not read."""

import gc
import json
import os
import resource
import socket
import stat
import struct
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from taxel.lingering import turn_off
from taxel.zenoh_process import open_session
from taxel_bench.plain_client import client_config
from taxel_bench.server_process import free_port

_ON = struct.pack("ii", 1, 10)

Pair = tuple[socket.socket, socket.socket]


def is_on(connection: socket.socket) -> bool:
    option = connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.calcsize("ii"))
    return struct.unpack("ii", option)[0] == 1


def open_files() -> set[int]:
    return {int(each.name) for each in Path("/dev/fd").iterdir()}


def lingering_at(port: int) -> dict[int, bool]:
    """Whether each of this process's connections whose own port this is lingers, by the other port."""
    found = {}
    with ExitStack() as opened:
        for number in open_files():
            try:
                if not stat.S_ISSOCK(os.fstat(number).st_mode):
                    continue
                each = opened.enter_context(socket.socket(fileno=os.dup(number)))
                if each.family != socket.AF_UNIX and each.getsockname()[1] == port:
                    found[each.getpeername()[1]] = is_on(each)
            except OSError:
                # Closed meanwhile, or not connected.
                continue
    return found


def listening(place: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([place]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return config


@pytest.fixture(params=[socket.AF_INET, socket.AF_INET6])
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    """Two ends of a connection, both of which linger."""
    host = {socket.AF_INET: "127.0.0.1", socket.AF_INET6: "::1"}[request.param]
    with (
        socket.create_server((host, 0), family=request.param) as listener,
        socket.create_connection(listener.getsockname()[:2]) as theirs,
        listener.accept()[0] as own,
    ):
        for each in (own, theirs):
            each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _ON)
        yield own, theirs


def test_only_the_named_end_is_turned_off_and_nothing_stays_open(pair: Pair, tmp_path: Path) -> None:
    own, theirs = pair
    with (tmp_path / "file").open("w"), socket.socket(), socket.socket(socket.AF_UNIX):
        before = open_files()
        assert turn_off(own.getsockname()[1], theirs.getsockname()[1])
        assert not is_on(own)
        assert is_on(theirs)
        assert not turn_off(own.getsockname()[1], 1)
        assert open_files() == before
    own.sendall(b"still open")
    assert theirs.recv(100) == b"still open"


@pytest.mark.parametrize("host", ["127.0.0.1", "[::1]"])
def test_a_session_ends_each_connection_without_lingering(host: str) -> None:
    place = f"tcp/{host}:{(port := free_port())}"
    with open_session(listening(place)), zenoh.open(client_config(place)), zenoh.open(client_config(place)):
        gc.collect()
        ends = time.monotonic() + 10
        while list(lingering_at(port).values()) != [False, False] and time.monotonic() < ends:
            time.sleep(0.01)
        assert list(lingering_at(port).values()) == [False, False]


def test_a_client_ends_its_connection_without_lingering() -> None:
    place = f"tcp/127.0.0.1:{(port := free_port())}"
    with zenoh.open(listening(place)), open_session(client_config(place)):
        ends = time.monotonic() + 10
        while not (theirs := [*lingering_at(port)]) and time.monotonic() < ends:
            time.sleep(0.01)
        own = theirs[0]
        while any(lingering_at(own).values()) and time.monotonic() < ends:
            time.sleep(0.01)
        assert lingering_at(own) == {port: False}
        # The other end is zenoh's alone.
        assert lingering_at(port) == {own: True}


def test_a_link_without_a_port_is_left_alone() -> None:
    before = open_files()
    assert not turn_off(None, None)
    # Others may close theirs meanwhile.
    assert open_files() <= before


def test_a_process_that_may_open_no_more_files_leaves_connections_as_they_are() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    try:
        assert not turn_off(1, 2)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))

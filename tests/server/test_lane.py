"""The lane with real sockets: what it answers, and what it does with clients that break its rules."""

import os
import signal
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import taxel
from taxel.errors import (
    Internal,
    InvalidArgument,
    NotFound,
    RequestError,
    ResourceExhausted,
)
from taxel.lane.connection import ConnectionLost, LaneConnection
from taxel.lane.frames import ERROR, pack_cancel, pack_request_head, read_counts, read_error
from taxel.lane.offer import LaneOffer
from taxel.protocol import unpackb
from taxel_server.engine import Engine, LoadedModel
from taxel_server.transports import lane_connection, lane_transport

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]

SKIN = "v2/models/skin/infer"
WIDE = "v2/models/wide/infer"


def lane_of(endpoint: str) -> str:
    """The address of a server's lane, as its metadata tell it."""
    with taxel.connect(endpoint, transport="zenoh") as source:
        offer = LaneOffer.read(unpackb(source.get("taxel/v2")))
        assert offer is not None
        return offer.address


@pytest.fixture
def lane(engine: Engine, start: ServerStarter) -> str:
    return lane_of(start(engine, max_request_rows=5000))


@pytest.fixture
def connection(lane: str) -> Iterator[LaneConnection]:
    opened = LaneConnection(lane)
    yield opened
    opened.close()


def ask(connection: LaneConnection, windows: NDArray[np.float32], path: str = SKIN) -> NDArray[np.float32]:
    number = connection.send(path, windows, 10, 10, spread=False)
    answered, counts = answer(connection)
    assert answered == number
    return counts


def answer(connection: LaneConnection) -> tuple[int, NDArray[np.float32]]:
    """The id and the counts of the next reply."""
    head, content = connection.receive(10)
    return head.id, read_counts(content, head)[0]


def test_every_request_of_a_pipeline_is_answered_once(
    connection: LaneConnection, engine: Engine, make_windows: WindowMaker
) -> None:
    wrong = make_windows(2)
    wrong[1, 3] = np.nan
    asked: dict[int, NDArray[np.float32] | type[RequestError]] = {}
    cases = [
        (SKIN, make_windows(1), None),
        (SKIN, make_windows(3000, seed=1), None),
        (WIDE, make_windows(5, 12), None),
        (SKIN, wrong, InvalidArgument),
        (SKIN, make_windows(1, 7), InvalidArgument),
        (SKIN, make_windows(4000, 12), InvalidArgument),
        (SKIN, make_windows(5001), ResourceExhausted),
        ("v2/models/skn/infer", make_windows(900), NotFound),
        ("v2/health/ready", make_windows(1), NotFound),
        ("v2/models/skin/versions/2/infer", make_windows(40, seed=2), None),
    ]
    model = {SKIN: ("skin", None), WIDE: ("wide", None)}
    for path, windows, error in cases * 4:
        number = connection.send(path, windows, 10, 10, spread=False)
        asked[number] = error or engine.model(*model.get(path, ("skin", "2"))).evaluate(windows)
    found = Counter[int]()
    for _ in asked:
        head, content = connection.receive(10)
        found[head.id] += 1
        expected = asked[head.id]
        if isinstance(expected, type):
            assert head.kind == ERROR
            assert type(read_error(content)) is expected
        else:
            np.testing.assert_array_equal(read_counts(content, head)[0], expected)
    assert found == dict.fromkeys(asked, 1)
    connection.socket.setblocking(False)
    with pytest.raises(BlockingIOError):
        connection.socket.recv(1)


@pytest.mark.parametrize("step", [1, 5, 33])
def test_a_request_may_come_in_pieces(
    lane: str, engine: Engine, make_windows: WindowMaker, step: int
) -> None:
    windows = make_windows(9)
    whole = pack_request_head(SKIN, 1, windows.shape, 0, spread=False) + windows.tobytes()
    connection = LaneConnection(lane)
    for first in range(0, 2 * len(whole), step):
        connection.socket.sendall((whole * 2)[first : first + step])
    for _ in range(2):
        np.testing.assert_array_equal(answer(connection)[1], engine.model("skin").evaluate(windows))
    connection.close()


def test_a_spread_that_there_is_none_of_and_a_wrong_timeout_are_refused(connection: LaneConnection) -> None:
    for timeout_s, spread, text in (
        (10, True, "no spread"),
        (-1, False, "timeout_ms"),
        (np.nan, False, "nan"),
    ):
        connection.send(SKIN, np.zeros((1, 6), np.float32), timeout_s, 10, spread=spread)
        with pytest.raises(InvalidArgument, match=text):
            answer(connection)


GOOD = pack_request_head(SKIN, 1, (2, 6), 0, spread=False) + bytes(48)
BROKEN = {
    "another protocol": b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n" + bytes(99),
    "zeros": bytes(64),
    "another version": b"TXL2" + GOOD[4:],
    "a reply": GOOD[:8] + b"\2" + GOOD[9:],
    "a size that does not fit": GOOD[:4] + struct.pack("<I", len(GOOD) + 4) + GOOD[8:],
    "the largest size": GOOD[:4] + b"\xff" * 4 + GOOD[8:],
    "the longest path": GOOD[:10] + b"\xff\xff" + GOOD[12:],
    "a huge shape": GOOD[:16] + b"\xff" * 8 + GOOD[24:],
}


@pytest.mark.parametrize("data", BROKEN.values(), ids=BROKEN)
def test_what_is_no_frame_is_told_and_closed(
    connection: LaneConnection, lane: str, data: bytes, make_windows: WindowMaker
) -> None:
    breaking = LaneConnection(lane)
    breaking.socket.sendall(data)
    head, content = breaking.receive(10)
    assert (head.kind, head.id) == (ERROR, 0)
    assert isinstance(read_error(content), InvalidArgument)
    with pytest.raises(ConnectionLost):
        breaking.receive(10)
    breaking.close()
    assert ask(connection, make_windows(1)).shape == (1, 21)


def test_a_request_is_refused_before_its_windows_are_read(
    connection: LaneConnection, make_windows: WindowMaker
) -> None:
    shape = (5_000_000, 6)
    connection.socket.sendall(pack_request_head(SKIN, 1, shape, 0, spread=False))
    with pytest.raises(ResourceExhausted, match="5000000 rows: expected at most 5000"):
        answer(connection)
    block = bytes(2**20)
    left = 4 * shape[0] * shape[1]
    while left:
        left -= connection.socket.send(block[: min(left, len(block))])
    assert ask(connection, make_windows(1)).shape == (1, 21)


def test_a_client_that_makes_no_progress_is_closed_and_others_go_on(
    engine: Engine, start: ServerStarter, make_windows: WindowMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lane_transport, "_PATIENCE_S", 0.5)
    lane = lane_of(start(engine))
    whole = pack_request_head(WIDE, 1, (4000, 12), 0, spread=False) + bytes(4 * 48_000)
    good, truncated, unread = (LaneConnection(lane) for _ in range(3))
    truncated.socket.sendall(whole[:-1000])
    unread.socket.setblocking(False)
    sending = 0
    with pytest.raises((BrokenPipeError, ConnectionResetError)):
        while True:
            assert ask(good, make_windows(1)).shape == (1, 21)
            try:
                sending += unread.socket.send(whole[sending % len(whole) :])
            except BlockingIOError:
                time.sleep(0.005)
    assert sending > len(whole)
    with pytest.raises(ConnectionLost):
        truncated.receive(10)
    assert ask(good, make_windows(1)).shape == (1, 21)
    for each in (good, truncated, unread):
        each.close()


def test_large_requests_in_part_are_limited(
    engine: Engine, start: ServerStarter, make_windows: WindowMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lane_transport, "_MOST_BYTES", 500_000)
    lane = lane_of(start(engine))
    large = pack_request_head(SKIN, 1, (15_000, 6), 0, spread=False)
    begun, refused, small = (LaneConnection(lane) for _ in range(3))
    begun.socket.sendall(large)
    assert ask(small, make_windows(1)).shape == (1, 21)
    refused.socket.sendall(large)
    with pytest.raises(ResourceExhausted, match="large requests"):
        answer(refused)
    begun.close()
    windows = make_windows(4000)
    for first in (0, 1):
        small.send(SKIN, windows[first:], 10, 10, spread=False)
    assert [answer(small)[1].shape for _ in range(2)] == [(4000, 21), (3999, 21)]
    for each in (refused, small):
        each.close()


def test_a_flood_takes_no_answer_from_others(
    engine: Engine, start: ServerStarter, make_windows: WindowMaker
) -> None:
    lane = lane_of(start(engine, max_queue_requests=16))
    windows = make_windows(1)
    flood = (pack_request_head(SKIN, 1, windows.shape, 0, spread=False) + windows.tobytes()) * 20_000
    flooding, good = LaneConnection(lane), LaneConnection(lane)
    flooding.socket.setblocking(False)
    sent = answered = 0
    while sent < len(flood):
        try:
            sent += flooding.socket.send(flood[sent : sent + 60_000])
        except BlockingIOError:
            while True:
                try:
                    flooding.socket.recv(2**20)
                except BlockingIOError:
                    break
        try:
            answered += len(ask(good, windows))
        except ResourceExhausted:
            answered += 1
    assert answered > 10
    for each in (flooding, good):
        each.close()


_KILLED = """
import sys, numpy as np
from taxel.lane.connection import LaneConnection
windows = np.zeros((3000, 12), np.float32)
connections = [LaneConnection(sys.argv[1]) for _ in range(10)]
for connection in connections:
    for _ in range(20):
        connection.send("v2/models/wide/infer", windows, 5, 5, spread=False)
        if connection is not connections[0]:
            break
print("sent", flush=True)
sys.stdin.read()
"""


def usage() -> tuple[int, int, int]:
    """Open files, threads and resident pages of this process."""
    resident = int(Path("/proc/self/statm").read_text().split()[1])
    return len(os.listdir("/proc/self/fd")), threading.active_count(), resident  # noqa: PTH208


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads /proc")
def test_clients_that_come_and_go_or_are_killed_leave_nothing(lane: str, make_windows: WindowMaker) -> None:
    windows = make_windows(2000, 12)

    def come_and_go(clients: int) -> None:
        for number in range(clients):
            client = LaneConnection(lane)
            if number % 3:
                assert ask(client, windows[: 1 + number % 50], WIDE).shape[1] == 21
            if number % 5 == 0:
                client.send(WIDE, windows, 10, 10, spread=False)
            client.close()

    come_and_go(100)
    files, threads, pages = usage()
    for _ in range(3):
        process = subprocess.Popen(
            [sys.executable, "-c", _KILLED, lane], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        with process:
            assert process.stdout is not None
            assert process.stdout.readline() == "sent\n"
            process.send_signal(signal.SIGKILL)
    come_and_go(300)
    ends = time.monotonic() + 10
    while usage()[0] > files and time.monotonic() < ends:
        time.sleep(0.05)
    after = usage()
    assert after[0] <= files
    assert after[1] == threads
    assert after[2] - pages < 64 * 2**20 // os.sysconf("SC_PAGESIZE")


def test_a_failure_at_one_client_harms_no_other(
    lane: str, connection: LaneConnection, make_windows: WindowMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing = LaneConnection(lane)
    with monkeypatch.context() as patched:

        def fail(*_: object) -> None:
            raise ArithmeticError("odd")

        patched.setattr(lane_connection, "LaneJob", fail)
        with pytest.raises(Internal, match="log says more"):
            ask(failing, make_windows(1))
        patched.setattr(lane_connection, "read_request_head", fail)
        failing.send(SKIN, make_windows(2), 10, 10, spread=False)
        with pytest.raises(ConnectionLost):
            failing.receive(10)
    assert ask(connection, make_windows(1)).shape == (1, 21)
    failing.close()


def test_requests_like_the_last_one_and_unlike_it_are_told_apart(
    connection: LaneConnection, engine: Engine, make_windows: WindowMaker
) -> None:
    for seed in range(20):
        for path, name, features in ((SKIN, "skin", 6), (SKIN, "skin", 6), (WIDE, "wide", 12)):
            windows = make_windows(1, features, seed)
            np.testing.assert_array_equal(
                ask(connection, windows, path), engine.model(name).evaluate(windows)
            )
    windows[0, 0] = np.inf
    for _ in range(2):
        with pytest.raises(InvalidArgument, match="is inf"):
            ask(connection, windows, WIDE)
        with pytest.raises(InvalidArgument, match="expected"):
            ask(connection, windows, SKIN)


def test_a_repeated_small_request_is_answered_at_once_whatever_was_asked_before(
    connection: LaneConnection, engine: Engine, make_windows: WindowMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads = set()
    evaluate = LoadedModel.evaluate

    def noting(model: LoadedModel, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        threads.add(threading.current_thread().name)
        return evaluate(model, windows)

    monkeypatch.setattr(lane_connection, "_KINDS", 4)
    monkeypatch.setattr(LoadedModel, "evaluate", noting)
    for rows in range(1, 17):
        windows = make_windows(rows)
        ask(connection, windows)
        threads.clear()
        np.testing.assert_array_equal(
            ask(connection, windows), engine.model("skin").runtime.evaluate(windows)
        )
        assert "taxel-batcher" not in threads


def test_what_came_before_no_frame_is_answered_first(lane: str, make_windows: WindowMaker) -> None:
    windows = make_windows(3)
    head = pack_request_head(SKIN, 7, windows.shape, 10_000, spread=False)
    breaking = LaneConnection(lane)
    breaking.socket.sendall(2 * (head + windows.tobytes()) + b"x" * 40)
    heads = [breaking.receive(10)[0] for _ in range(3)]
    assert Counter((reply.id, reply.kind == ERROR) for reply in heads) == {(7, False): 2, (0, True): 1}
    with pytest.raises(ConnectionLost):
        breaking.receive(10)
    breaking.close()


def test_a_cancellation_of_nothing_does_nothing_and_another_frame_of_its_kind_is_none(
    lane: str, engine: Engine, make_windows: WindowMaker
) -> None:
    windows = make_windows(3)
    request = pack_request_head(SKIN, 7, windows.shape, 10_000, spread=False) + windows.tobytes()
    connection = LaneConnection(lane)
    connection.socket.sendall(pack_cancel(7) + request[:50])
    connection.socket.sendall(request[50:] + pack_cancel(8)[:31])
    assert connection.receive(10)[0].id == 7
    connection.socket.sendall(pack_cancel(8)[31:] + 2 * pack_cancel(7) + request)
    answered, counts = answer(connection)
    assert answered == 7
    np.testing.assert_array_equal(counts, engine.model("skin").evaluate(windows))
    connection.socket.sendall(pack_cancel(7)[:-1] + b"x")
    head, content = connection.receive(10)
    assert head.id == 0
    with pytest.raises(InvalidArgument, match="expected a cancellation"):
        read_counts(content, head)
    with pytest.raises(ConnectionLost):
        connection.receive(10)
    connection.close()

"""The lane over WebSockets: the same bytes, for pages from here and for nobody else's."""

import socket
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import ClientConnection, connect

import taxel
from taxel.errors import SettingsError, TaxelError
from taxel.lane.frames import HEAD_BYTES, pack_request_head, read_counts, read_error, read_reply_head
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.service import Service
from taxel_server.settings import read_settings
from taxel_server.transports import web_socket

WindowMaker = Callable[..., NDArray[np.float32]]
ServerStarter = Callable[..., str]
SKIN = "v2/models/skin/infer"


@pytest.fixture
def port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        found: int = probe.getsockname()[1]
    return found


@pytest.fixture
def address(engine: Engine, start: ServerStarter, port: int) -> str:
    start(engine, websocket=f"127.0.0.1:{port}", websocket_origins=("https://robot.example",))
    return f"ws://127.0.0.1:{port}/"


def opened(address: str, **options: Any) -> ClientConnection:
    return connect(address, compression=None, max_size=None, **options)


def request(windows: NDArray[np.float32], number: int = 7, path: str = SKIN) -> bytes:
    return pack_request_head(path, number, windows.shape, 0.0, spread=False) + windows.tobytes()


def counts(reply: str | bytes) -> NDArray[np.float32]:
    assert isinstance(reply, bytes)
    head = read_reply_head(reply[:HEAD_BYTES])
    (found,) = read_counts(reply[HEAD_BYTES:], head)
    return found


def test_a_frame_in_a_message_gets_the_lanes_numbers(
    engine: Engine, start: ServerStarter, port: int, make_windows: WindowMaker
) -> None:
    windows = make_windows(5000)
    with taxel.connect(start(engine, websocket=f"127.0.0.1:{port}")) as source:
        expected = source.predictor("skin").predict(windows)
        with opened(f"ws://localhost:{port}/") as page:
            page.send(request(windows, 1))
            page.send(request(windows[:3], 2))
            replies = [counts(page.recv()) for _ in range(2)]
    np.testing.assert_array_equal(max(replies, key=len), expected)
    np.testing.assert_array_equal(min(replies, key=len), expected[:3])


def test_an_error_is_the_lanes_and_the_connection_goes_on(address: str, make_windows: WindowMaker) -> None:
    with opened(address) as page:
        page.send(request(make_windows(1), path="v2/models/skn/infer"))
        reply = page.recv()
        assert isinstance(reply, bytes)
        assert "no model 'skn'" in str(read_error(reply[HEAD_BYTES:]))
        page.send(request(make_windows(1)))
        assert counts(page.recv()).shape == (1, 21)


@pytest.mark.parametrize(
    "origin",
    [None, "http://127.0.0.1:5173", "http://localhost", "https://[::1]:8", "https://robot.example"],
)
def test_pages_from_here_and_named_ones_may_come(address: str, origin: str | None) -> None:
    with opened(address, origin=origin):
        pass


@pytest.mark.parametrize(
    "origin",
    [
        "https://evil.example",
        "null",
        "http://localhost.evil.example",
        "http://127.0.0.1@evil.example",
        "http://[",
    ],
)
def test_a_page_from_elsewhere_is_refused(address: str, origin: str) -> None:
    with pytest.raises(InvalidStatus) as refused:
        opened(address, origin=origin)
    assert refused.value.response.status_code == 403
    assert b"expected a page from loopback" in (refused.value.response.body or b"")


def test_a_name_that_was_turned_to_this_machine_is_refused(address: str, port: int) -> None:
    """As a page's own server can do with the page's name, once the page is there."""
    with socket.create_connection(("127.0.0.1", port)) as asked:
        asked.sendall(
            b"GET / HTTP/1.1\r\nHost: evil.example\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
        )
        assert asked.recv(4096).startswith(b"HTTP/1.1 403 ")


def test_a_message_that_is_too_long_or_a_text_ends_the_connection_alone(
    address: str, make_windows: WindowMaker
) -> None:
    with opened(address) as bystander:
        for message, code in ((bytes(2**20 + 1), 1009), ("a text", 1003)):
            with opened(address) as page, pytest.raises(ConnectionClosedError) as closed:
                page.send(message)
                page.recv()
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == code
        bystander.send(request(make_windows(1)))
        assert counts(bystander.recv()).shape == (1, 21)


def test_bytes_that_are_no_frame_get_the_lanes_error_and_the_end(address: str) -> None:
    with opened(address) as page:
        page.send(b"GET / HTTP/1.1\r\n" * 4)
        reply = page.recv()
        assert isinstance(reply, bytes)
        assert read_reply_head(reply[:HEAD_BYTES]).id == 0
        with pytest.raises(ConnectionClosedError) as closed:
            page.recv()
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.reason == "the lane has closed the connection"


def test_pages_beyond_the_limit_are_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_socket, "_MOST_PAGES", 1)
    with opened(address), pytest.raises(InvalidStatus, match="503"):
        opened(address)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"websocket": "0.0.0.0:7449"}, "expected a port of loopback"),
        ({"websocket": "127.0.0.1:7449", "lane": "off"}, "expected a lane"),
        ({"websocket": "127.0.0.1:7449", "users": "users"}, "any user of the machine may ask there"),
    ],
)
def test_a_place_that_would_let_others_in_is_refused(options: dict[str, str], reason: str) -> None:
    with pytest.raises(SettingsError, match=reason):
        read_settings(options)


def test_an_occupied_port_stops_the_start_and_leaves_nothing_open(
    engine: Engine, endpoint: str, port: int
) -> None:
    with socket.create_server(("127.0.0.1", port)):
        options = ServerOptions(listen=(endpoint,), websocket=f"127.0.0.1:{port}")
        with pytest.raises(TaxelError, match=f"websocket: cannot listen on 127.0.0.1:{port}: Address"):
            Service(engine, options).start()
    again = Service(engine, options).start()
    assert again.websocket == f"ws://127.0.0.1:{port}/"
    assert again.close()

"""What the page's server answers, and to whom."""

import asyncio
import json
import socket
from collections.abc import Callable
from http.client import HTTPConnection
from typing import Any
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from taxel.errors import SettingsError
from taxel_watch.pacing import IN_FLIGHT
from taxel_watch.page_server import page_files, page_server
from taxel_watch.replay import Replay
from taxel_watch.scene import Source

Serve = Callable[[Source], str]


def get(address: str, path: str, **headers: str) -> tuple[int, str, bytes]:
    place = urlsplit(address)
    assert place.hostname is not None
    connection = HTTPConnection(place.hostname, place.port, timeout=20)
    try:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers["Content-Type"], answer.read()
    finally:
        connection.close()


def stream(address: str, **options: Any) -> ClientConnection:
    return connect(address.replace("http", "ws") + "stream", **options)


def next_of(kind: str, page: ClientConnection) -> dict[str, Any]:
    while True:
        message: dict[str, Any] = json.loads(page.recv(timeout=20))
        if message["type"] == kind:
            return message


def test_the_page_is_complete_and_asks_nobody_else(serve: Serve, paced: Replay) -> None:
    address = serve(paced)
    status, kind, html = get(address, "/")
    assert (status, kind) == (200, "text/html; charset=utf-8")
    assert b"<title>Taxel watch</title>" in html
    assert get(address, "/main.js?1")[:2] == (200, "text/javascript; charset=utf-8")
    assert get(address, "/vendor/uPlot.esm.js")[0] == 200
    for path, (_, content) in page_files().items():
        if not path.startswith("/vendor/"):
            assert b"https://" not in content, path
            assert b"http://" not in content.replace(b"http://www.w3.org/", b""), path


@pytest.mark.parametrize("path", ["/none.js", "/../pyproject.toml", "/%2e%2e/scene.py", "/vendor", "//etc"])
def test_nothing_else_is_served(serve: Serve, paced: Replay, path: str) -> None:
    assert get(serve(paced), path)[0] == 404


def test_other_sites_get_nothing(serve: Serve, paced: Replay) -> None:
    address = serve(paced)
    assert get(address, "/", Host="evil.example")[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        stream(address, origin="http://evil.example")
    with stream(address, origin=address.rstrip("/")) as page:
        assert next_of("scene", page)["title"] == "two.csv"


def test_a_page_that_draws_nothing_gets_two_frames_and_no_queue(
    serve: Serve, paced: Replay, clock: Any
) -> None:
    paced.loops = True
    with stream(serve(paced)) as page:
        # The player starts when the server has seen the connection, which is after this end has.
        next_of("scene", page)
        numbers, dropped = [], 0
        while dropped < 5:
            clock.now += 0.05
            message = json.loads(page.recv(timeout=20))
            if message["type"] == "frame":
                numbers.append(message["number"])
            if message["type"] == "status":
                dropped = message["viewer"]["dropped"]
        assert numbers == list(range(1, IN_FLIGHT + 1))
        clock.now += 0.05
        page.send(json.dumps({"name": "drawn", "value": 1}))
        frame = next_of("frame", page)
        assert frame["number"] == IN_FLIGHT + 1
        # It is the newest moment, and brings the rows that were not sent.
        assert frame["at_s"] == pytest.approx(clock.now % 6.0, abs=0.011)


@pytest.mark.parametrize(
    "text",
    [
        *("", "[]", "7", "null", "{", '{"name": 3}', '{"name": "seek"}', '{"name": "seek", "value": NaN}'),
        *('{"name": "seek", "value": "far"}', '{"name": "seek", "value": 1e999}', "[" * 2000, b"\xff\x00"),
    ],
)
def test_what_a_page_should_not_say_is_ignored(serve: Serve, paced: Replay, text: str | bytes) -> None:
    with stream(serve(paced)) as page:
        page.send(text)
        page.send(json.dumps({"name": "pause"}))
        while next_of("status", page)["state"] != "paused":
            pass


def test_a_port_in_use_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]

        async def serve() -> None:
            async with page_server(Never(), "127.0.0.1", port):
                pytest.fail("it listens")

        with pytest.raises(SettingsError, match=f"cannot listen on 127.0.0.1:{port}.*--port 0"):
            asyncio.run(serve())


class Never:
    """A source that nobody comes to see."""

    def player(self) -> Any:
        raise AssertionError

    def close(self) -> None:
        pass

"""The HTTP client program against a real HTTP server of the standard library."""

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from taxel_bench.compare.peer_programs.http_client import HttpClient

FEATURES = 12


class Repeating(BaseHTTPRequestHandler):
    """Answers each window with its first value, 21 times; refuses windows that start with -1."""

    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        windows = np.frombuffer(body, "<f4").reshape(-1, FEATURES)
        answer = np.repeat(windows[:, :1], 21, axis=1).tobytes()
        self.send_response(500 if windows[0, 0] == -1 else 200)
        if windows[0, 0] != -2:
            self.send_header("content-length", str(len(answer)))
        self.end_headers()
        self.wfile.write(answer)

    def log_message(self, *values: object) -> None:
        """Say nothing."""


@pytest.fixture
def client() -> Iterator[HttpClient]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Repeating) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        client = HttpClient("127.0.0.1", server.server_address[1])
        yield client
        client.connect(0)
        server.shutdown()
        thread.join()


def windows_from(value: float, rows: int = 1) -> np.ndarray:
    return np.full((rows, FEATURES), value, np.float32) + np.arange(rows, dtype=np.float32)[:, None]


@pytest.mark.parametrize("rows", [1, 7, 5000])
def test_rows_come_back_in_order(client: HttpClient, rows: int) -> None:
    client.connect(1)
    for value in (3, 4):
        windows = windows_from(value, rows)
        np.testing.assert_array_equal(client.ask(windows), np.repeat(windows[:, :1], 21, axis=1))


@pytest.mark.parametrize(("queries", "at_once"), [(0, 4), (3, 8), (50, 8), (8, 8)])
def test_every_query_is_answered(client: HttpClient, queries: int, at_once: int) -> None:
    client.connect(at_once)
    assert client.ask_many((windows_from(value) for value in range(queries)), at_once) == queries


@pytest.mark.parametrize(("value", "text"), [(-1, "answered http/1.1 500"), (-2, "no content-length")])
def test_another_answer_is_refused(client: HttpClient, value: float, text: str) -> None:
    client.connect(1)
    with pytest.raises(ConnectionError, match=text):
        client.ask(windows_from(value))

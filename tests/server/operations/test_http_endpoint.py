"""The HTTP endpoint answers health checks beside clients that ask nothing, ask slowly or read nothing."""

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from urllib.request import urlopen

import pytest
from prometheus_client import CollectorRegistry, Counter

from taxel_server.operations.http_endpoint import HttpEndpoint

_BAD = 40

REQUESTS = {
    "nothing": b"",
    "half a request": b"GET /metrics HTTP/1.1\r\nHost: ",
    "requests whose answers they do not read": b"GET /metrics HTTP/1.1\r\nHost: here\r\n\r\n" * 20,
}


@pytest.fixture
def endpoint() -> Iterator[HttpEndpoint]:
    registry = CollectorRegistry()
    for number in range(2000):
        Counter(
            f"some_{number}", "A long text, so that answers fill a connection. " * 10, registry=registry
        )
    opened = HttpEndpoint("127.0.0.1:0", registry, lambda: True, lambda: False)
    opened.start()
    yield opened
    opened.close()


def ask(endpoint: HttpEndpoint, path: str) -> bytes:
    with urlopen(f"http://{endpoint.address}{path}", timeout=30) as answer:
        content: bytes = answer.read()
    return content


@pytest.mark.parametrize("request_sent", REQUESTS.values(), ids=REQUESTS)
def test_bad_clients_keep_nobody_from_an_answer(endpoint: HttpEndpoint, request_sent: bytes) -> None:
    host, _, port = endpoint.address.rpartition(":")
    before = threading.active_count()
    with ExitStack() as clients:
        for _ in range(_BAD):
            bad = clients.enter_context(socket.create_connection((host, int(port))))
            with suppress(OSError):  # Its place may have been taken already.
                bad.sendall(request_sent)
        for _ in range(3):
            assert json.loads(ask(endpoint, "/v2/health/live")) == {"live": True}
            assert b"some_1999_total" in ask(endpoint, "/metrics")
        # Those whose place was taken are let go.
        ends = time.monotonic() + 30
        while threading.active_count() > before + 8 and time.monotonic() < ends:
            time.sleep(0.01)
        assert threading.active_count() <= before + 8

"""Metrics and health over HTTP, for Prometheus and orchestrators. It answers no inference."""

import json
import logging
import socket
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import TCPServer
from threading import Lock, Thread
from typing import Any, Final

from prometheus_client import CollectorRegistry
from prometheus_client.exposition import choose_encoder
from typing_extensions import override

from taxel.errors import TaxelError
from taxel_server.options import host_and_port

_LOG: Final = logging.getLogger(__name__)

_PATIENCE_S: Final = 5.0
"""How long a client may take for its request."""

_AT_ONCE: Final = 8
"""Clients that are answered at the same time. One more takes the place of the oldest, which may be one that
asks nothing, or reads nothing: a health check must get its answer beside it."""


class HttpEndpoint:
    """Answers `/metrics`, `/v2/health/live` and `/v2/health/ready` from `start` until `close`.

    Args:
        address: `HOST:PORT`; port 0 is any free one.
        registry: the metrics.
        live: whether the server makes progress.
        ready: whether it takes requests.

    Attributes:
        address: where it listens.

    Raises:
        TaxelError: it cannot be listened on.
    """

    def __init__(
        self,
        address: str,
        registry: CollectorRegistry,
        live: Callable[[], bool],
        ready: Callable[[], bool],
    ) -> None:
        place = host_and_port(address)
        self.registry = registry
        self.health = {"/v2/health/live": ("live", live), "/v2/health/ready": ("ready", ready)}
        try:
            self._server = _Server(place, self)
        except OSError as error:
            raise TaxelError(f"http: cannot listen on {address}: {error.strerror or error}") from None
        host, port = self._server.server_address[:2]
        self.address = f"{host!s}:{port}"
        self._thread = Thread(target=self._server.serve_forever, name="taxel-http", daemon=True)

    def start(self) -> None:
        """Start answering."""
        self._thread.start()

    def close(self) -> None:
        """Stop."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, place: tuple[str, int], endpoint: HttpEndpoint) -> None:
        self.endpoint = endpoint
        self._changing = Lock()
        self._open: dict[socket.socket, None] = {}  # From the oldest.
        self.address_family = socket.AF_INET6 if ":" in place[0] else socket.AF_INET
        super().__init__(place, _Handler)

    @override
    def server_bind(self) -> None:
        # HTTPServer's own would ask the network for this machine's name, and wait for it.
        TCPServer.server_bind(self)

    @override
    def process_request(self, request: Any, client_address: Any) -> None:
        with self._changing:
            if len(self._open) >= _AT_ONCE:
                oldest = next(iter(self._open))
                del self._open[oldest]
                with suppress(OSError):  # Its client has gone.
                    # Its thread sees an end, and closes it.
                    oldest.shutdown(socket.SHUT_RDWR)
            self._open[request] = None
        super().process_request(request, client_address)

    @override
    def shutdown_request(self, request: Any) -> None:
        with self._changing:
            self._open.pop(request, None)
        super().shutdown_request(request)

    @override
    def handle_error(
        self, request: socket.socket | tuple[bytes, socket.socket], client_address: Any
    ) -> None:
        _LOG.debug("an HTTP client failed: %s", client_address, exc_info=True)


class _Handler(BaseHTTPRequestHandler):
    timeout = _PATIENCE_S
    server: _Server
    server_version = "taxel"
    sys_version = ""

    def do_GET(self) -> None:
        endpoint = self.server.endpoint
        path = self.path.partition("?")[0]
        if path == "/metrics":
            encode, content_type = choose_encoder(self.headers.get("Accept", ""))
            self._answer(HTTPStatus.OK, content_type, encode(endpoint.registry))
        elif path in endpoint.health:
            name, holds = endpoint.health[path]
            found = holds()
            status = HTTPStatus.OK if found else HTTPStatus.SERVICE_UNAVAILABLE
            self._answer(status, "application/json", json.dumps({name: found}).encode() + b"\n")
        else:
            known = ", ".join(("/metrics", *endpoint.health))
            self._answer(HTTPStatus.NOT_FOUND, "text/plain; charset=utf-8", f"there is: {known}\n".encode())

    do_HEAD = do_GET  # noqa: N815

    def _answer(self, status: HTTPStatus, content_type: str, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    @override
    def log_message(self, format: str, *args: Any) -> None:
        _LOG.debug("%s: " + format, self.address_string(), *args)

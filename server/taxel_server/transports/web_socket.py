"""The lane for web pages: a WebSocket of a page is one more client of the lane, with its limits and errors.

Each message of a client is a frame of a request, and each message of the server a frame of a reply. Bytes
are passed on as they are. A page of another site in the same browser could come here: its Origin tells it.
"""

import asyncio
import logging
import socket
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from threading import Event, Thread
from typing import Final
from urllib.parse import urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.http11 import Request, Response

from taxel.endpoints import is_loopback
from taxel.errors import TaxelError
from taxel.lane.frames import HEAD_BYTES
from taxel.lane.offer import parse_address
from taxel_server.options import host_and_port

_LOG: Final = logging.getLogger(__name__)

_LONGEST_MESSAGE: Final = 2**20
"""Of a request, bytes. A longer one ends the connection before it is read."""

_MOST_PAGES: Final = 64
"""Connections at a time, each of which may make the server hold some messages; further ones are refused."""

_FAREWELL_S: Final = 0.1
"""How long closing waits for pages to close, too."""


class WebSocketTransport:
    """Listens from construction, and passes frames to the lane and back from `start` until `close`.

    Args:
        address: `HOST:PORT` on loopback; port 0 is any free one.
        origins: of pages that may come, such as `https://robot.example`, beside those from loopback.
        lane: where the lane listens.

    Attributes:
        address: for pages, as `ws://HOST:PORT/`.

    Raises:
        TaxelError: it cannot be listened on.
    """

    def __init__(self, address: str, origins: tuple[str, ...], lane: str) -> None:
        host, port = host_and_port(address)
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._socket = socket.create_server((host, port), family=family)
        except OSError as error:
            raise TaxelError(f"websocket: cannot listen on {address}: {error.strerror or error}") from None
        self.address = f"ws://{address.rpartition(':')[0]}:{self._socket.getsockname()[1]}/"
        self._origins = origins
        self._lane = lane
        self._pages = 0
        self._ready = Event()
        self._stop: Callable[[], object] = self._socket.close
        self._thread = Thread(target=lambda: asyncio.run(self._run()), name="taxel-websocket", daemon=True)

    def start(self) -> None:
        """Take pages."""
        self._thread.start()
        self._ready.wait()

    def close(self) -> None:
        """Close all connections; call it after the core was drained, before the lane closes."""
        self._stop()
        if self._thread.is_alive():
            self._thread.join()

    async def _run(self) -> None:
        loop, ended = asyncio.get_running_loop(), asyncio.Event()
        self._stop = lambda: loop.call_soon_threadsafe(ended.set)
        self._ready.set()
        async with serve(
            self._serve,
            sock=self._socket,
            process_request=self._refused,
            compression=None,
            max_size=_LONGEST_MESSAGE,
            max_queue=1,
            close_timeout=_FAREWELL_S,
            server_header="taxel",
        ):
            await ended.wait()

    def _refused(self, connection: ServerConnection, request: Request) -> Response | None:
        """The answer to a page of another site, or of another name of this server; None if it may come."""
        host, origin = request.headers.get("Host"), request.headers.get("Origin")
        if not _is_of_loopback(f"//{host}"):
            return connection.respond(HTTPStatus.FORBIDDEN, f"host {host}: expected a name of loopback\n")
        if self._pages >= _MOST_PAGES:
            return connection.respond(
                HTTPStatus.SERVICE_UNAVAILABLE, f"{_MOST_PAGES} pages are connected\n"
            )
        # A program that is no browser sends no origin.
        if origin is None or origin in self._origins or _is_of_loopback(origin):
            return None
        _LOG.warning("a page of %.200r was refused: see --websocket-origins", origin)
        text = f"origin {origin}: expected a page from loopback, or of --websocket-origins\n"
        return connection.respond(HTTPStatus.FORBIDDEN, text)

    async def _serve(self, page: ServerConnection) -> None:
        self._pages += 1
        try:
            await self._pass_on(page)
        finally:
            self._pages -= 1

    async def _pass_on(self, page: ServerConnection) -> None:
        place = parse_address(self._lane)
        try:
            if isinstance(place, Path):
                reader, writer = await asyncio.open_unix_connection(place)
            else:
                reader, writer = await asyncio.open_connection(*place)
        except OSError as error:
            await page.close(CloseCode.TRY_AGAIN_LATER, f"no lane: {error.strerror}")
            return
        replies = asyncio.create_task(_give_replies(reader, page))
        try:
            async for message in page:
                if isinstance(message, str):
                    await page.close(CloseCode.UNSUPPORTED_DATA, "expected binary messages")
                    break
                writer.write(message)
                await writer.drain()
        except (ConnectionClosed, ConnectionError):
            pass
        finally:
            replies.cancel()
            writer.close()
            with suppress(asyncio.CancelledError, ConnectionError):
                await replies


async def _give_replies(reader: asyncio.StreamReader, page: ServerConnection) -> None:
    """Each reply of the lane is a message. While a page does not read them, nothing more is taken."""
    with suppress(ConnectionClosed):
        try:
            while True:
                head = await reader.readexactly(HEAD_BYTES)
                size = int.from_bytes(head[4:8], "little")
                await page.send(head + await reader.readexactly(size - HEAD_BYTES))
        except (asyncio.IncompleteReadError, ConnectionError):
            await page.close(CloseCode.TRY_AGAIN_LATER, "the lane has closed the connection")


def _is_of_loopback(address: str) -> bool:
    try:
        host = urlsplit(address).hostname
    except ValueError:
        return False
    return host is not None and is_loopback(host)

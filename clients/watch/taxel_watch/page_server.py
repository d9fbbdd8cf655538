"""Serves the page and its data from one port: files over HTTP, scenes and updates over a WebSocket."""

import asyncio
import contextlib
import json
import logging
import math
from collections.abc import AsyncIterator, Mapping
from functools import cache
from http import HTTPStatus
from importlib.resources import files
from typing import Any, Final
from urllib.parse import urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from taxel.errors import SettingsError
from taxel_watch.messages import encoded, scene_message, update_message
from taxel_watch.pacing import Pacing
from taxel_watch.scene import RATE_HZ, Player, Source

_LOG: Final = logging.getLogger(__name__)

_STATUS_S: Final = 0.5
_LONGEST_MESSAGE: Final = 4096
"""Of a page, bytes."""

_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}

_LOOPBACK: Final = frozenset({"localhost", "127.0.0.1", "::1"})

_HEADERS: Final = {
    "Cache-Control": "no-cache",
    "X-Content-Type-Options": "nosniff",
    # Everything comes from here; uPlot sets styles of its own elements.
    "Content-Security-Policy": "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:",
}


@cache
def page_files() -> Mapping[str, tuple[str, bytes]]:
    """Content type and content of every file of the page, by path; nothing else is served."""
    root = files(__package__) / "page"
    found: dict[str, tuple[str, bytes]] = {}
    folders = [("/", root)]
    while folders:
        path, folder = folders.pop()
        for entry in folder.iterdir():
            if entry.is_dir():
                folders.append((f"{path}{entry.name}/", entry))
            elif (suffix := entry.name[entry.name.rfind(".") :]) in _TYPES:
                found[path + entry.name] = (_TYPES[suffix], entry.read_bytes())
    found["/"] = found["/index.html"]
    return found


@contextlib.asynccontextmanager
async def page_server(source: Source, host: str, port: int) -> AsyncIterator[str]:
    """Serve a source's page, and give its address.

    Args:
        source: what is shown; each page gets a player of its own.
        host: where to listen.
        port: 0 is any free one.

    Raises:
        SettingsError: it cannot be listened on.
    """
    allowed = _LOOPBACK | {host}

    def answer(_: ServerConnection, request: Request) -> Response | None:
        return _answered(request, allowed)

    async def show(connection: ServerConnection) -> None:
        await _show(connection, source.player())

    try:
        server = await serve(
            show,
            host,
            port,
            process_request=answer,
            compression=None,
            max_size=_LONGEST_MESSAGE,
            server_header="taxel",
        )
    except OSError as error:
        raise SettingsError(
            f"cannot listen on {host}:{port}: {error.strerror or error}; expected a free port: "
            "--port 0 takes any"
        ) from None
    async with server:
        yield f"http://{_shown(host)}:{_port_of(server)}/"


def _shown(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _port_of(server: Server) -> int:
    port: int = next(iter(server.sockets)).getsockname()[1]
    return port


def _answered(request: Request, allowed: frozenset[str]) -> Response | None:
    """A file, or an error; None for a WebSocket that may be opened.

    Another site's page in the same browser could ask this port, too. Its Origin, or the Host that its name
    was turned to, tells it.
    """
    if not _is_ours(request.headers.get("Host"), allowed):
        return _response(HTTPStatus.FORBIDDEN, b"this page is not served under that name\n")
    path = request.path.partition("?")[0]
    if path == "/stream":
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != request.headers.get("Host"):
            return _response(HTTPStatus.FORBIDDEN, b"the stream is for this server's own page\n")
        return None
    found = page_files().get(path)
    if found is None:
        return _response(HTTPStatus.NOT_FOUND, b"there is no such file\n")
    return _response(HTTPStatus.OK, found[1], found[0])


def _is_ours(host: str | None, allowed: frozenset[str]) -> bool:
    """Whether a request names this server. If it listens on every address, all names may be its own."""
    if "0.0.0.0" in allowed or "::" in allowed:
        return True
    try:
        return urlsplit(f"//{host}").hostname in allowed
    except ValueError:
        return False


def _response(
    status: HTTPStatus, content: bytes, content_type: str = "text/plain; charset=utf-8"
) -> Response:
    headers = Headers(_HEADERS)
    headers["Content-Type"] = content_type
    headers["Content-Length"] = str(len(content))
    headers["Connection"] = "close"
    return Response(status.value, status.phrase, headers, content)


async def _show(connection: ServerConnection, player: Player) -> None:
    """Send scenes, updates and states to one page, until it leaves."""
    pacing = Pacing()
    hearing = asyncio.create_task(_hear(connection, player, pacing))
    try:
        await _send(connection, player, pacing)
    except ConnectionClosed:
        pass
    finally:
        hearing.cancel()
        with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
            await hearing


async def _send(connection: ServerConnection, player: Player, pacing: Pacing) -> None:
    loop = asyncio.get_running_loop()
    due = loop.time()
    status_due = due
    while True:
        if (scene := player.scene()) is not None:
            await connection.send(encoded(scene_message(scene)))
        if pacing.may_send() and (update := player.update()) is not None:
            pacing.note_sent()
            await connection.send(encoded(update_message(update, pacing.sent)))
        if loop.time() >= status_due:
            status_due = loop.time() + _STATUS_S
            viewer = {"sent": pacing.sent, "dropped": pacing.dropped}
            await connection.send(encoded({"type": "status", **player.status(), "viewer": viewer}))
        due = max(due + 1.0 / RATE_HZ, loop.time())
        await asyncio.sleep(due - loop.time())


async def _hear(connection: ServerConnection, player: Player, pacing: Pacing) -> None:
    """Take what the page says. What it should not say is ignored."""
    async for text in connection:
        name, value = _command(text)
        if name == "drawn":
            pacing.note_drawn()
        elif name:
            player.command(name, value)


def _command(text: str | bytes) -> tuple[str, float]:
    """The name and the number of a message; an empty name if it is none."""
    try:
        message: Any = json.loads(text)
        name, value = message["name"], float(message.get("value", 0))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        _LOG.debug("a page sent what is no command: %.80r", text)
        return "", 0.0
    return (name, value) if isinstance(name, str) and math.isfinite(value) else ("", 0.0)

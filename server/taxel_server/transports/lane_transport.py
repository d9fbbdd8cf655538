"""The lane: frames over a local socket, for clients on this machine. One thread reads all of them.

It answers a single window itself if nothing else waits. It never waits for a client: a client that owes
bytes, or does not read its replies, is closed after the lane's patience.
"""

import logging
import os
import socket
import time
from collections import deque
from contextlib import suppress
from threading import Thread
from typing import Final

from taxel.errors import TaxelError
from taxel.lane.offer import LaneOffer, machine_identity, of_this_user
from taxel_server.core.core import Core
from taxel_server.options import ServerOptions
from taxel_server.transports.lane_connection import EXTENSIONS, RECEIVE_BYTES, ClientConnection
from taxel_server.transports.lane_requests import Budget
from taxel_server.transports.lane_socket import LaneSocket, automatic_address
from taxel_server.transports.poller import READ, WRITE, open_poller

_LOG: Final = logging.getLogger(__name__)

_PATIENCE_S: Final = 5.0
"""How long a client may leave a request unfinished, or a reply unread, without any progress."""

_SWEEP_S: Final = 0.25
"""How often clients that owe something are looked at."""

_MOST_CLIENTS: Final = 512
_MOST_BYTES: Final = 256 * 2**20
"""Of requests in part, and of replies that wait, over all clients."""

_FAREWELL_S: Final = 0.2
"""How long closing waits for clients that are still to read their replies."""

_give_way: Final = getattr(os, "sched_yield", lambda: None)
"""Lets a client run that shares this core."""


class LaneTransport:
    """Listens from `listen`, and answers from `start` until `close`.

    Args:
        core: what answers.
        options: where to listen.
    """

    def __init__(self, core: Core, options: ServerOptions) -> None:
        self._core = core
        self._options = options
        self._budget = Budget(_MOST_BYTES)
        self._buffer = bytearray(RECEIVE_BYTES)
        self._clients: dict[int, ClientConnection] = {}
        """By the socket's descriptor."""
        self._under_way: set[ClientConnection] = set()
        self._notified: deque[ClientConnection] = deque()
        self._accepts_again_at = 0.0
        self._stop_at: float | None = None
        self._socket: LaneSocket | None = None
        self._thread: Thread | None = None

    def listen(self) -> LaneOffer | None:
        """Open the socket, and say how clients find it. None if there is no lane.

        Raises:
            TaxelError: the address that was asked for cannot be listened on.
        """
        if self._options.lane == "off":
            return None
        if self._options.lane == "auto":
            try:
                self._socket = LaneSocket(automatic_address(self._options.listen))
            except TaxelError as error:
                _LOG.warning("there is no lane for clients on this machine: %s", error)
                return None
        else:
            self._socket = LaneSocket(self._options.lane)
        return LaneOffer(self._socket.address, machine_identity(), EXTENSIONS)

    def start(self) -> None:
        """Take requests, if there is a lane."""
        if self._socket is None:
            return
        self._core.statistics.connections["lane"] = lambda: len(self._clients)
        self._listener = self._socket.socket
        self._waker, self._woken = socket.socketpair()
        self._waker.setblocking(False)
        self._woken.setblocking(False)
        self._poller = open_poller()
        self._poller.register(self._listener, READ)
        self._poller.register(self._woken, READ)
        self._thread = Thread(target=self._run, name="taxel-lane", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Give clients a moment to read their replies, and close; call it after the core was drained."""
        if self._socket is None:
            return
        if self._thread is not None:
            self._stop_at = time.monotonic() + _FAREWELL_S
            self._wake()
            self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        while self._stop_at is None or self._may_go_on(self._stop_at):
            try:
                self._turn()
            except Exception:
                # The thread must survive whatever a client does.
                _LOG.exception("the lane failed at a client")
        for connection in list(self._clients.values()):
            self._drop(connection)
        self._poller.close()
        self._waker.close()
        self._woken.close()

    def _may_go_on(self, stop_at: float) -> bool:
        """Whether replies wait, and there is time."""
        waiting = any(connection.has_outbox for connection in self._clients.values())
        return waiting and time.monotonic() < stop_at

    def _turn(self) -> None:
        """Wait for clients, and serve those that are ready."""
        idle = not self._under_way and not self._accepts_again_at and self._stop_at is None
        events = self._spin() if self._options.spin_us else []
        if not events:
            events = self._poller.poll(None if idle else _SWEEP_S)
        alone = len(events) == 1
        for descriptor, event in events:
            connection = self._clients.get(descriptor)
            if connection is not None:
                self._serve(connection, event, alone)
            elif descriptor == self._woken.fileno():
                self._hear()
            elif descriptor == self._listener.fileno():
                self._accept()
        if not idle:
            self._sweep()

    def _spin(self) -> list[tuple[int, int]]:
        """Ask again and again for clients that are ready, for as long as the options say."""
        ends = time.monotonic() + self._options.spin_us / 1e6
        while not (events := self._poller.poll(0)) and time.monotonic() < ends:
            _give_way()
        return events

    def _serve(self, connection: ClientConnection, event: int, alone: bool) -> None:
        """Read from a client, or send what it takes."""
        try:
            if event & WRITE:
                connection.flush()
                stays = True
            elif alone and connection.answer_alone():
                return
            else:
                stays = connection.read()
        except BlockingIOError:
            return
        except OSError:
            stays = False
        except Exception:
            _LOG.exception("the lane failed at a client")
            stays = False
        if not stays or connection.is_closed:
            self._drop(connection)
        elif connection.is_under_way or connection in self._under_way:
            self._watch(connection)

    def _watch(self, connection: ClientConnection) -> None:
        """Wait for the client to read if replies wait for it, and else for its requests."""
        if connection.is_under_way:
            self._under_way.add(connection)
        else:
            self._under_way.discard(connection)
        wanted = WRITE if connection.has_outbox else READ
        if connection.awaited != wanted:
            self._poller.modify(connection.socket, wanted)
            connection.awaited = wanted

    def _drop(self, connection: ClientConnection) -> None:
        self._under_way.discard(connection)
        if self._clients.pop(connection.socket.fileno(), None) is not None:
            self._poller.unregister(connection.socket)
            connection.close()

    def _accept(self) -> None:
        try:
            client, _ = self._listener.accept()
        except (BlockingIOError, ConnectionError):
            return
        except OSError as error:
            _LOG.warning("the lane cannot take a client: %s", error)
            self._poller.unregister(self._listener)
            self._accepts_again_at = time.monotonic() + _SWEEP_S
            return
        unix = client.family not in (socket.AF_INET, socket.AF_INET6)
        if len(self._clients) >= _MOST_CLIENTS or (unix and not of_this_user(client)):
            client.close()
            return
        client.setblocking(False)
        if not unix:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients[client.fileno()] = ClientConnection(
            client, self._core, self._budget, self._buffer, self._notify
        )
        self._poller.register(client, READ)

    def _notify(self, connection: ClientConnection) -> None:
        """Called by any thread: a client's outbox has filled, or it has gone."""
        self._notified.append(connection)
        self._wake()

    def _wake(self) -> None:
        # If the pipe is full, or closed at the end, the thread needs no further sign.
        with suppress(OSError):
            self._waker.send(b"\0")

    def _hear(self) -> None:
        with suppress(BlockingIOError):
            self._woken.recv(4096)
        while self._notified:
            connection = self._notified.popleft()
            if connection.is_closed:
                self._drop(connection)
            elif self._clients.get(connection.socket.fileno()) is connection:
                self._watch(connection)

    def _sweep(self) -> None:
        """Close clients that made no progress, and accept again after a failure."""
        now = time.monotonic()
        for connection in [*self._under_way]:
            if now - connection.progressed_at > _PATIENCE_S:
                _LOG.debug("the lane closes a client that made no progress")
                self._drop(connection)
        if self._accepts_again_at and now >= self._accepts_again_at:
            self._accepts_again_at = 0.0
            self._poller.register(self._listener, READ)

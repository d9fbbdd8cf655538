"""Bytes on their way out of a socket of an event loop."""

import asyncio
import socket
from asyncio import AbstractEventLoop
from collections import deque
from collections.abc import Callable
from typing import Final

_MUCH_BYTES: Final = 65_536
"""If more is unsent, further calls wait."""


class Outgoing:
    """Sends what the socket takes at once, and the rest when it takes more.

    Args:
        loop: the running loop.
        connection: a socket that does not block.
        lost: told why nothing can be sent any more.

    Attributes:
        may_send: whether little is unsent.
    """

    def __init__(
        self, loop: AbstractEventLoop, connection: socket.socket, lost: Callable[[str], None]
    ) -> None:
        self._loop = loop
        self._socket = connection
        self._lost = lost
        self._unsent: deque[memoryview] = deque()
        self.may_send = asyncio.Event()
        self.may_send.set()

    def send(self, data: bytes) -> None:
        """Send, now or later."""
        sent = 0
        if not self._unsent:
            try:
                sent = self._socket.send(data)
            except (BlockingIOError, InterruptedError):
                pass
            except OSError as error:
                self._lost(str(error))
                return
            if sent == len(data):
                return
            self._loop.add_writer(self._socket, self._send_more)
        self._unsent.append(memoryview(data)[sent:])
        if sum(map(len, self._unsent)) > _MUCH_BYTES:
            self.may_send.clear()

    def end(self) -> None:
        """Forget what is unsent."""
        self._loop.remove_writer(self._socket)
        self._unsent.clear()
        self.may_send.set()

    def _send_more(self) -> None:
        try:
            while self._unsent:
                sent = self._socket.send(self._unsent[0])
                self._unsent[0] = self._unsent[0][sent:]
                if not self._unsent[0]:
                    self._unsent.popleft()
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._lost(str(error))
            return
        self._loop.remove_writer(self._socket)
        self.may_send.set()

"""Waits for sockets: what `selectors` does, with as little Python as possible on a request's way."""

import select
import selectors
import socket
from typing import Final, Protocol

READ: Final = getattr(select, "EPOLLIN", selectors.EVENT_READ)
"""There is something to read; the other end may also have gone."""

WRITE: Final = getattr(select, "EPOLLOUT", selectors.EVENT_WRITE)
"""There is room to write."""


class Poller(Protocol):
    """Sockets, each with the one event that is waited for."""

    def register(self, watched: socket.socket, event: int, /) -> object:
        """Wait for an event of one more socket."""

    def modify(self, watched: socket.socket, event: int, /) -> object:
        """Wait for another event of a socket."""

    def unregister(self, watched: socket.socket, /) -> object:
        """Forget a socket."""

    def poll(self, timeout: float | None = None, /) -> list[tuple[int, int]]:
        """Wait, for seconds or without end, for sockets that are ready: their descriptors and events."""

    def close(self) -> None:
        """Forget all."""


class _Selector:
    """Where there is no epoll."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self.register = self._selector.register
        self.modify = self._selector.modify
        self.unregister = self._selector.unregister
        self.close = self._selector.close

    def poll(self, timeout: float | None = None) -> list[tuple[int, int]]:
        """As `Poller.poll`."""
        return [(key.fd, events) for key, events in self._selector.select(timeout)]


def open_poller() -> Poller:
    """The system's own way of waiting: epoll on Linux."""
    return select.epoll() if hasattr(select, "epoll") else _Selector()

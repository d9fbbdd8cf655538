"""Asks over HTTP/1.1 by plain sockets that are kept alive: the leanest client that Python has.

A library such as requests or httpx would add more than most servers take.
"""

import selectors
import socket
from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from .client import Client, client_arguments, counts_of, obey

_PATH = "/predict"
_RECEIVE_BYTES = 262_144
_END_OF_HEAD = b"\r\n\r\n"


class HttpConnection:
    """One connection; one request at a time."""

    def __init__(self, address: str, port: int) -> None:
        self.socket = socket.create_connection((address, port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._head = (
            f"POST {_PATH} HTTP/1.1\r\nHost: {address}:{port}\r\n"
            "Content-Type: application/octet-stream\r\nContent-Length: "
        ).encode()

    def send(self, body: bytes) -> None:
        """Send a request."""
        self.socket.sendall(b"%b%d\r\n\r\n%b" % (self._head, len(body), body))

    def receive(self) -> bytes:
        """Wait for the response's body.

        Raises:
            ConnectionError: the response is not 200, has no length, or the server has gone.
        """
        received = self._more()
        while (end := received.find(_END_OF_HEAD)) < 0:
            received += self._more()
        head = received[:end].lower()
        if not head.startswith(b"http/1.1 200"):
            raise ConnectionError(f"the server answered {head.splitlines()[0].decode('latin-1')}")
        _, found, length = head.partition(b"\r\ncontent-length:")
        if not found:
            raise ConnectionError("the server's answer has no content-length")
        first = end + len(_END_OF_HEAD)
        whole = first + int(length.split(b"\r\n", 1)[0])
        if len(received) < whole:
            parts = [received]
            missing = whole - len(received)
            while missing:
                parts.append(self._more())
                missing -= len(parts[-1])
            received = b"".join(parts)
        return received[first:]

    def _more(self) -> bytes:
        data = self.socket.recv(_RECEIVE_BYTES)
        if not data:
            raise ConnectionError("the server closed the connection")
        return data


class HttpClient(Client):
    """As many connections as there are queries at once."""

    def __init__(self, address: str, port: int) -> None:
        self._place = (address, port)
        self._connections: list[HttpConnection] = []

    @override
    def connect(self, at_once: int) -> None:
        for connection in self._connections:
            connection.socket.close()
        self._connections = [HttpConnection(*self._place) for _ in range(at_once)]

    @override
    def ask(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        connection = self._connections[0]
        connection.send(windows.tobytes())
        return counts_of(connection.receive())

    @override
    def ask_many(self, queries: Iterator[NDArray[np.float32]], at_once: int) -> int:
        answered = on_their_way = 0
        with selectors.DefaultSelector() as selector:
            for connection, query in zip(self._connections[:at_once], queries, strict=False):
                selector.register(connection.socket, selectors.EVENT_READ, connection)
                connection.send(query.tobytes())
                on_their_way += 1
            while on_their_way:
                for key, _ in selector.select():
                    counts_of(key.data.receive())
                    answered += 1
                    on_their_way -= 1
                    for following in islice(queries, 1):
                        key.data.send(following.tobytes())
                        on_their_way += 1
        return answered


def main() -> None:
    """Obey until stdin ends."""
    arguments = client_arguments().parse_args()
    obey(HttpClient(arguments.address, arguments.port), arguments.windows)


if __name__ == "__main__":
    main()

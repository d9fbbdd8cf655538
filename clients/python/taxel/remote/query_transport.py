"""The seam between the client and what carries its messages: a key and a payload, and one answer.

zenoh is one such transport; the server's memory transport is another. The lane carries frames instead, and
only inference (`taxel.lane`).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, Literal, Protocol

from taxel.errors import RequestError

Done = Callable[[bytes | RequestError], None]
"""Called with the result of a query."""


def nothing_to_give_up() -> None:
    """Of a query that has ended, or whose server need not be told."""


class Polled(Protocol):
    """A query on its way, whose answer can be looked for."""

    def look(self) -> bytes | None:
        """The answer, if it is there; raises as the function that `QueryTransport.start` returns."""

    def give_up(self) -> None:
        """Nobody waits for the answer any more: the server is told."""


class QueryTransport(ABC):
    """Queries the keys of a server; each query has one answer. Thread-safe.

    Attributes:
        name: what a predictor calls it.
        endpoint: where the server is, for error texts.
    """

    name: ClassVar[Literal["zenoh", "memory"]]
    endpoint: str

    @property
    @abstractmethod
    def connected(self) -> bool:
        """Whether queries can reach a server now."""

    @abstractmethod
    def start(
        self, key: str, payload: bytes | None, timeout: float, cancel_key: str | None = None
    ) -> Callable[[], bytes]:
        """Send a query at once, and return a function that waits for its answer; call it once.

        Args:
            key: the key to query.
            payload: the content of the query.
            timeout: seconds to wait for the answer.
            cancel_key: where the server is told if the wait ends without the answer; None if it needs not.

        Raises:
            RequestError: by the function returned: the server's typed error; `DeadlineExceeded` if the
                answer does not come in time; `ServerLost`, `PermissionDenied` or `Unavailable` if there
                is none.
        """

    @abstractmethod
    def send(
        self, key: str, payload: bytes | None, timeout: float, done: Done, cancel_key: str | None = None
    ) -> Callable[[], None]:
        """Send a query, as `start` does, without waiting. Any number of such queries may be in flight.

        Args:
            done: called exactly once with the answer, or with the error that `start` would raise, on any
                thread. It must return quickly.

        Returns:
            What to call if nobody waits for the answer any more: it tells the server. `done` is called all
            the same.
        """

    def start_polled(
        self, key: str, payload: bytes | None, timeout: float, cancel_key: str | None = None
    ) -> Polled | None:
        """Send a query, as `start` does; None, and nothing is sent, where answers cannot be looked for."""
        del key, payload, timeout, cancel_key
        return None

    @abstractmethod
    def silence(self, key: str) -> RequestError:
        """The error of a query that was ended early and without an answer."""

    def prepare(self, key: str, timeout: float) -> None:  # noqa: B027 (most have nothing to prepare)
        """Many queries of this key and timeout will follow."""

    @abstractmethod
    def close(self) -> None:
        """End it. Later queries raise `Unavailable`."""

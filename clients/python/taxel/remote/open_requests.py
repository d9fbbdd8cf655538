"""How many requests a connection has under way: no more than the server lets it queue."""

from collections.abc import Callable
from threading import RLock

from taxel.errors import RequestError, ResourceExhausted

Ended = Callable[[object], None]
"""Called with what a request ended with; only the first call counts."""


class OpenRequests:
    """Refuses here what the server would refuse. Thread-safe.

    A server that refuses a request says how many others of this client it holds. From then on, half as many
    may be under way: what goes beyond costs neither side a message. A request of fewer bytes than any that
    was refused may still find room, so that it is sent. After as many answers as may be under way, it is
    one more. So TCP's window is halved at a loss and grows while nothing is lost (RFC 5681). Once none is
    under way, there is no limit.
    """

    def __init__(self) -> None:
        # A signal may come while its own thread holds it, and its handler may send a request, too.
        self._lock = RLock()
        self._open = 0
        self._limit: int | None = None
        self._least_size = 0
        """Bytes of the smallest request that was refused."""
        self._answers = 0
        """Since the limit last changed."""

    def begin(self, size: int) -> Ended:
        """Count a request that is sent now.

        Args:
            size: its bytes.

        Returns:
            What to call once it has ended.

        Raises:
            ResourceExhausted: as many are under way as the server lets this client queue.
        """
        with self._lock:
            if self._limit is not None and self._open >= self._limit and size >= self._least_size:
                raise ResourceExhausted(
                    f"{self._open} requests of this connection are under way, as many as the server lets "
                    "it queue: this one was not sent; try again once one of them is answered"
                )
            self._open += 1
        ended = False

        def end(outcome: object) -> None:
            nonlocal ended
            with self._lock:
                if not ended:
                    ended = True
                    self._end(outcome, size)

        return end

    def _end(self, outcome: object, size: int) -> None:
        self._open -= 1
        if isinstance(outcome, ResourceExhausted) and outcome.open_requests is not None:
            self._least_size = size if self._limit is None else min(self._least_size, size)
            self._limit, self._answers = max(outcome.open_requests // 2, 1), 0
        elif self._limit is not None and not isinstance(outcome, RequestError):
            self._answers += 1
            if self._answers >= self._limit:
                self._limit, self._answers = self._limit + 1, 0
        if not self._open:
            self._limit = None


def not_counted(_: object) -> None:
    """Of a query that is no request for an inference."""

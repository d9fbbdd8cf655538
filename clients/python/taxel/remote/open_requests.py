"""How many requests a connection has under way: no more than the server lets it queue."""

from collections.abc import Callable
from threading import Lock

from taxel.errors import RequestError, ResourceExhausted

Ended = Callable[[object], None]
"""Called with what a request ended with; only the first call counts."""


class OpenRequests:
    """Refuses here what the server would refuse. Thread-safe.

    A server that refuses a request says how many others of this client it holds. From then on, so many
    may be under way: what goes beyond costs neither side a message. After as many answers as may be under
    way, it is one more, as TCP's window grows while nothing is lost (RFC 5681). Once none is under way,
    there is no limit.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._open = 0
        self._limit: int | None = None
        self._answers = 0
        """Since the limit last changed."""

    def begin(self) -> Ended:
        """Count a request that is sent now.

        Returns:
            What to call once it has ended.

        Raises:
            ResourceExhausted: as many are under way as the server lets this client queue.
        """
        with self._lock:
            if self._limit is not None and self._open >= self._limit:
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
                    self._end(outcome)

        return end

    def _end(self, outcome: object) -> None:
        self._open -= 1
        if isinstance(outcome, ResourceExhausted) and outcome.open_requests is not None:
            self._limit, self._answers = max(outcome.open_requests, 1), 0
        elif self._limit is not None and not isinstance(outcome, RequestError):
            self._answers += 1
            if self._answers >= self._limit:
                self._limit, self._answers = self._limit + 1, 0
        if not self._open:
            self._limit = None


def not_counted(_: object) -> None:
    """Of a query that is no request for an inference."""

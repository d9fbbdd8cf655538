"""Whose turn it is: the clients of a model, and the models.

Both take turns by deficit round robin (Shreedhar and Varghese, Efficient Fair Queuing Using Deficit
Round-Robin, IEEE/ACM Transactions on Networking 4, 1996). Clients are counted in windows. Models are
counted in seconds, which are known only afterwards; so a model that took more than its turn waits until its
debt is paid.
"""

from collections import deque
from collections.abc import Hashable, Set
from typing import Any, Final, Generic, Protocol, TypeVar

_CLIENT_ROWS: Final = 64
"""A client's turn, in windows."""

_LONGEST_S: Final = 1.0
"""If an evaluation took longer, the whole process may have been stopped: the model must not pay for it."""


class Queued(Protocol):
    """A request with windows left to take."""

    client: Hashable
    left: int


T = TypeVar("T", bound=Queued)


class ClientTurns(Generic[T]):
    """Requests for one model. Each client's own requests stay in order."""

    def __init__(self) -> None:
        self._queues: dict[Hashable, deque[T]] = {}
        self._order: deque[Hashable] = deque()
        self._credit = _CLIENT_ROWS
        """Windows that the first client may still take in this turn."""

    def __bool__(self) -> bool:
        return bool(self._order)

    def add(self, request: T) -> None:
        """Queue a request with at least one window left."""
        queue = self._queues.get(request.client)
        if queue is None:
            queue = self._queues[request.client] = deque()
            self._order.append(request.client)
        queue.append(request)

    def remove(self, request: T) -> None:
        """Take a request out; it must be queued."""
        queue = self._queues[request.client]
        queue.remove(request)
        if not queue:
            self._leave(request.client)

    def first(self) -> T:
        """The request whose windows are taken next."""
        return self._queues[self._order[0]][0]

    def take(self, room: int) -> tuple[T, int]:
        """Take windows of the first request: the request, and how many.

        Its `left` is less by as many afterwards. A request without windows left leaves the queue.
        """
        client = self._order[0]
        request = self._queues[client][0]
        rows = min(room, request.left, self._credit)
        request.left -= rows
        self._credit -= rows
        if not request.left:
            self._queues[client].popleft()
        if not self._queues[client]:
            self._leave(client)
        elif not self._credit:
            self._order.rotate(-1)
            self._credit = _CLIENT_ROWS
        return request, rows

    def _leave(self, client: Hashable) -> None:
        if self._order[0] == client:
            self._credit = _CLIENT_ROWS
        del self._queues[client]
        self._order.remove(client)


class ModelTurns(Generic[T]):
    """The requests of all models.

    Args:
        turn_s: a model's turn, in seconds.
    """

    def __init__(self, turn_s: float) -> None:
        self._turn_s = turn_s
        self._clients: dict[Hashable, ClientTurns[T]] = {}
        self._order: deque[Hashable] = deque()
        self._credit: dict[Hashable, float] = {}

    def __bool__(self) -> bool:
        return bool(self._order)

    def add(self, model: Hashable, request: T) -> None:
        """Queue a request for a model."""
        clients = self._clients.get(model)
        if clients is None:
            clients = self._clients[model] = ClientTurns()
            self._order.append(model)
            self._credit.setdefault(model, self._turn_s)
        clients.add(request)

    def remove(self, model: Hashable, request: T) -> None:
        """Take a request out; it must be queued."""
        self._clients[model].remove(request)
        self.settle(model)

    def choose(self) -> tuple[Hashable, ClientTurns[T]]:
        """The model whose turn it is, and its requests. Call `settle` after some were taken."""
        while self._credit[self._order[0]] <= 0:
            self._credit[self._order[0]] += self._turn_s
            self._order.rotate(-1)
        return self._order[0], self._clients[self._order[0]]

    def settle(self, model: Hashable) -> None:
        """Forget a model that nobody asks any more, but not its debt while others wait."""
        if self._clients[model]:
            return
        del self._clients[model]
        self._order.remove(model)
        if self._order:
            self._credit[model] = min(self._credit[model], self._turn_s)
        else:
            self._credit.clear()

    def keep(self, models: Set[Any]) -> None:
        """Forget all other models, which nobody asks."""
        for model in self._credit.keys() - models:
            del self._credit[model]

    def charge(self, model: Hashable, seconds: float) -> None:
        """Count what an evaluation took; a single one is counted as `_LONGEST_S` at most."""
        if self._order:
            self._credit[model] = self._credit.get(model, self._turn_s) - min(seconds, _LONGEST_S)

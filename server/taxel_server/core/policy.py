"""What is accepted, refused, and evaluated next: a state machine without threads and without a clock.

Its events: a request arrives; the evaluator asks for the next slice, and says when it is done; a client
gives a request up, or is no longer there. Times are seconds on whichever clock the caller takes.
"""

from collections.abc import Hashable, Iterator, Set
from enum import IntEnum
from math import inf
from typing import Any, Final, Generic, NamedTuple, TypeVar

from taxel_server.core.shares import SMALL_ROWS, Amounts, Shares
from taxel_server.core.turns import ModelTurns

SLICE_S: Final = 0.004
"""How long a slice should take: a control request waits for no more than the slice that is evaluated."""

BULK_AFTER_S: Final = 7 * SLICE_S
"""Evaluation of control requests after which a bulk slice has its turn, if one waits.

So bulk gets at least an eighth of the time.
"""

_ROUND: Final = 64
"""Slices of that many windows, or a multiple, suit the evaluators."""

_WEIGHT: Final = 0.25
"""Of the newest slice in the estimate of a window's time."""


class Priority(IntEnum):
    """Control requests go before bulk requests."""

    CONTROL = 0
    BULK = 1


class Ticket:
    """A request as the policy sees it.

    Args:
        client: who asks, and has a share; compared by equality.
        model: what is asked.
        rows: its windows, at least 1.
        size: its bytes.
        deadline: after it, nobody waits for the answer any more.
        priority: if none, control for a small request, and bulk for others.
        source: what may be gone before the answer, such as a connection; the client if none.
        name: what the client calls it when it gives it up; None if it cannot. It must tell the client, too.

    Attributes:
        left: windows not taken yet.
        amounts: what it takes of the limits, once it has arrived.
    """

    amounts: Amounts

    def __init__(
        self,
        client: Hashable,
        model: Any,
        rows: int,
        size: int = 0,
        deadline: float = inf,
        priority: Priority | None = None,
        source: Hashable = None,
        name: Hashable = None,
    ) -> None:
        self.client = client
        self.name = name
        self.source = client if source is None else source
        self.model = model
        self.rows = rows
        self.size = size
        self.deadline = deadline
        self.priority = priority
        self.left = rows


T = TypeVar("T", bound=Ticket)


class Slice(NamedTuple, Generic[T]):
    """What is evaluated in one go: windows for one model.

    Attributes:
        model: of all pieces; None if there are only late requests.
        priority: of all pieces.
        pieces: requests, and how many of their next windows.
        late: requests whose deadline is over. They are not open any more.
    """

    model: Any
    priority: Priority
    pieces: list[tuple[T, int]]
    late: list[T]


class Policy(Generic[T]):
    """Each accepted request ends once: in `done`, as late, or dropped.

    Args:
        limits: the most that is open; each client may have one small request beyond them.
        max_slice_rows: the most windows of a slice.

    Attributes:
        shares: what is open, in all and by client.
    """

    def __init__(self, limits: Amounts, max_slice_rows: int) -> None:
        self.shares = Shares(limits)
        self._max_slice_rows = max_slice_rows
        self._small_rows = min(SMALL_ROWS, max_slice_rows)
        self._open: dict[T, None] = {}
        self._named: dict[Hashable, T] = {}
        """Open requests that have a name. If a client uses one twice, it is the newer request's."""
        self._turns: dict[Priority, ModelTurns[T]] = {each: ModelTurns(SLICE_S) for each in Priority}
        self._control_s = 0.0
        """Evaluation of control requests while bulk requests waited."""
        self._row_s: dict[Hashable, float] = {}
        """What a window probably takes, by model."""

    def __len__(self) -> int:
        """Requests accepted and not ended."""
        return len(self._open)

    def __iter__(self) -> Iterator[T]:
        """The open requests, in the order of their arrival."""
        return iter(list(self._open))

    def refusal(self, ticket: Ticket) -> str | None:
        """Why a request would be refused now; None if it would be accepted."""
        seconds = ticket.rows * self._row_s.get(ticket.model, 0.0)
        ticket.amounts = Amounts(1, ticket.rows, ticket.size, seconds)
        return self.shares.refusal(ticket)

    def arrive(self, ticket: T) -> str | None:
        """Accept a request, or return why it is refused."""
        refusal = self.refusal(ticket)
        if refusal is None:
            if ticket.priority is None:
                ticket.priority = Priority.CONTROL if ticket.rows <= self._small_rows else Priority.BULK
            self.shares.take(ticket)
            self._open[ticket] = None
            if ticket.name is not None:
                self._named[ticket.name] = ticket
            self._turns[ticket.priority].add(ticket.model, ticket)
        return refusal

    def next(self, now: float) -> Slice[T] | None:
        """What to evaluate next; None if nothing waits."""
        late: list[T] = []
        while (priority := self._next_priority()) is not None:
            turns = self._turns[priority]
            model, clients = turns.choose()
            pieces: dict[T, int] = {}
            room = self._slice_rows(model)
            while room and clients:
                first = clients.first()
                if now > first.deadline:
                    clients.remove(first)
                    self._end(first)
                    late.append(first)
                    continue
                ticket, rows = clients.take(room)
                pieces[ticket] = pieces.get(ticket, 0) + rows
                room -= rows
            turns.settle(model)
            if pieces:
                return Slice(model, priority, list(pieces.items()), late)
        return Slice(None, Priority.BULK, [], late) if late else None

    def shorten(self, ticket: T, rows: int) -> bool:
        """Note how many windows a request has, once its first slice was taken; it may have told more.

        Returns:
            Whether it is still open.
        """
        if ticket not in self._open:
            return False
        surplus = ticket.rows - rows
        if surplus > 0 and ticket.left:
            ticket.left = max(ticket.left - surplus, 0)
            if not ticket.left:
                self._leave_queue(ticket)
        return True

    def done(self, evaluated: Slice[T], seconds: float) -> list[T]:
        """Count an evaluation; returns the requests that it completes, which are not open any more."""
        rows = sum(rows for _, rows in evaluated.pieces)
        self._learn(evaluated.model, rows, seconds)
        self._turns[evaluated.priority].charge(evaluated.model, seconds)
        if evaluated.priority is Priority.BULK or not self._turns[Priority.BULK]:
            self._control_s = 0.0
        else:
            self._control_s += seconds
        return [ticket for ticket, _ in evaluated.pieces if not ticket.left and self._end(ticket)]

    def drop(self, ticket: T) -> bool:
        """End a request, wherever it is; False if it has ended already."""
        if ticket not in self._open:
            return False
        if ticket.left:
            self._leave_queue(ticket)
        return self._end(ticket)

    def cancel(self, name: Hashable) -> T | None:
        """End the request of this name, wherever it is; returns it, or None if there is none open."""
        ticket = self._named.get(name)
        if ticket is not None:
            self.drop(ticket)
        return ticket

    def gone(self, source: Hashable) -> list[T]:
        """End all requests of a source; returns them."""
        theirs = [ticket for ticket in self._open if ticket.source == source]
        return [ticket for ticket in theirs if self.drop(ticket)]

    def keep(self, models: Set[Any]) -> None:
        """Forget what was learnt of all other models, which have no open requests."""
        for model in self._row_s.keys() - models:
            del self._row_s[model]
        for turns in self._turns.values():
            turns.keep(models)

    def _end(self, ticket: T) -> bool:
        if ticket not in self._open:
            return False
        del self._open[ticket]
        if ticket.name is not None and self._named.get(ticket.name) is ticket:
            del self._named[ticket.name]
        self.shares.give(ticket)
        return True

    def _leave_queue(self, ticket: T) -> None:
        assert ticket.priority is not None
        self._turns[ticket.priority].remove(ticket.model, ticket)

    def _next_priority(self) -> Priority | None:
        """Whose turn it is."""
        control, bulk = self._turns[Priority.CONTROL], self._turns[Priority.BULK]
        if control and not (bulk and self._control_s >= BULK_AFTER_S):
            return Priority.CONTROL
        return Priority.BULK if bulk else None

    def _slice_rows(self, model: Hashable) -> int:
        row_s = self._row_s.get(model, 0.0)
        if row_s * self._max_slice_rows <= SLICE_S:
            return self._max_slice_rows
        rows = int(SLICE_S / row_s)
        return max(rows // _ROUND * _ROUND or rows, 1)

    def _learn(self, model: Hashable, rows: int, seconds: float) -> None:
        """Small slices say nothing: there, most of the time does not depend on the rows."""
        if rows < min(_ROUND, self._slice_rows(model)):
            return
        new = seconds / rows
        old = self._row_s.get(model, new)
        # A slice that the system interrupted says little.
        self._row_s[model] = old + _WEIGHT * (min(new, 2 * old) - old)

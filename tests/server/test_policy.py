"""The policy alone, in virtual time: it is held by what must be true after any events."""

from collections import defaultdict
from math import inf

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from taxel_server.core.policy import BULK_AFTER_S, SLICE_S, Policy, Priority, Slice, Ticket
from taxel_server.core.shares import SMALL_ROWS, Amounts

LIMITS = Amounts(requests=12, rows=2000, bytes=60_000, seconds=0.1)
MAX_SLICE_ROWS = 256
CLIENTS = ["ann", "ben", "cleo"]
AMPLE = Amounts(10**6, 10**7, 10**9, 1e3)
NUMBERS = range(1, 5)
SECONDS_A_ROW = {"fast": 1e-5, "slow": 4e-4}


class Events(RuleBasedStateMachine):
    """Any order of events. The test keeps its own account of what became of each request."""

    def __init__(self) -> None:
        super().__init__()
        self.policy: Policy[Ticket] = Policy(LIMITS, MAX_SLICE_ROWS)
        self.now = 0.0
        self.open: dict[Ticket, int] = {}
        """Accepted and not ended, with the rows that were taken."""
        self.newest: dict[object, Ticket] = {}
        """The request that had a name last."""
        self.ended: list[Ticket] = []
        self.running: Slice[Ticket] | None = None

    def has_open(self, client: str) -> bool:
        return any(ticket.client == client for ticket in self.open)

    @rule(
        client=st.sampled_from(CLIENTS),
        model=st.sampled_from(sorted(SECONDS_A_ROW)),
        rows=st.one_of(st.integers(1, 70), st.integers(1, 2500)),
        size=st.integers(0, 50_000),
        patience=st.one_of(st.just(inf), st.floats(0, 0.05)),
        number=st.sampled_from([None, *NUMBERS]),
    )
    def arrive(
        self, client: str, model: str, rows: int, size: int, patience: float, number: int | None
    ) -> None:
        name = None if number is None else (client, number)
        ticket = Ticket(client, model, rows, size, self.now + patience, name=name)
        before = self.policy.shares.taken
        refusal = self.policy.arrive(ticket)
        if refusal is None:
            self.open[ticket] = 0
            if name is not None:
                self.newest[name] = ticket
            assert ticket.priority == (Priority.BULK if rows > SMALL_ROWS else Priority.CONTROL)
        else:
            assert self.policy.shares.taken == before
            assert self.open, "an empty server takes any request"
            assert rows > SMALL_ROWS or self.has_open(client), "a small first request is never refused"

    @precondition(lambda self: self.running is None)
    @rule()
    def start(self) -> None:
        self.running = chosen = self.policy.next(self.now)
        if chosen is None:
            assert not self.open
            return
        for ticket in chosen.late:
            assert ticket.deadline < self.now
            del self.open[ticket]
        if not chosen.pieces:
            self.running = None
            return
        assert sum(rows for _, rows in chosen.pieces) <= MAX_SLICE_ROWS
        for ticket, rows in chosen.pieces:
            assert (ticket.model, ticket.priority) == (chosen.model, chosen.priority)
            assert ticket.deadline >= self.now
            assert rows > 0
            self.open[ticket] += rows
            assert self.open[ticket] <= ticket.rows
            ahead = [
                other
                for other in self.open
                if (other.client, other.model, other.priority)
                == (ticket.client, ticket.model, ticket.priority)
            ]
            assert all(self.open[other] == other.rows for other in ahead[: ahead.index(ticket)])

    @precondition(lambda self: self.running is not None)
    @rule(delay=st.floats(0, 3))
    def finish(self, delay: float) -> None:
        assert self.running is not None
        rows = sum(rows for _, rows in self.running.pieces)
        seconds = rows * SECONDS_A_ROW[self.running.model] * (1 + delay)
        self.now += seconds
        complete = [each for each, _ in self.running.pieces if self.open.get(each) == each.rows]
        assert self.policy.done(self.running, seconds) == complete
        for ticket in complete:
            del self.open[ticket]
        self.running = None

    @precondition(lambda self: self.open)
    @rule(data=st.data())
    def drop(self, data: st.DataObject) -> None:
        ticket = data.draw(st.sampled_from(list(self.open)))
        assert self.policy.drop(ticket)
        assert not self.policy.drop(ticket)
        del self.open[ticket]

    @rule(client=st.sampled_from(CLIENTS), number=st.sampled_from(NUMBERS))
    def give_up(self, client: str, number: int) -> None:
        """A request that is given up ends, wherever it is; a name that nothing open has ends nothing."""
        newest = self.newest.get((client, number))
        expected = newest if newest in self.open else None
        assert self.policy.cancel((client, number)) is expected
        assert self.policy.cancel((client, number)) is None
        if expected is not None:
            del self.open[expected]
            self.ended.append(expected)

    @precondition(lambda self: self.ended)
    @rule(data=st.data(), rows=st.integers(1, 50))
    def decode_too_late(self, data: st.DataObject, rows: int) -> None:
        """What has ended while it was decoded is not evaluated, and changes nothing."""
        ticket = data.draw(st.sampled_from(self.ended))
        taken = self.policy.shares.taken
        assert not self.policy.shorten(ticket, rows)
        assert self.policy.shares.taken == taken

    @rule(client=st.sampled_from(CLIENTS))
    def leave(self, client: str) -> None:
        gone = self.policy.gone(client)
        assert gone == [ticket for ticket in self.open if ticket.client == client]
        for ticket in gone:
            del self.open[ticket]
            self.ended.append(ticket)

    @rule(seconds=st.floats(0, 0.1))
    def wait(self, seconds: float) -> None:
        self.now += seconds

    @invariant()
    def what_is_open_is_counted_and_bounded(self) -> None:
        assert list(self.policy) == list(self.open)
        counted = self.policy.shares.taken
        assert counted[:3] == (
            len(self.open),
            sum(ticket.rows for ticket in self.open),
            sum(ticket.size for ticket in self.open),
        )
        small = len(CLIENTS) * SMALL_ROWS
        largest = max((ticket.rows for ticket in self.open), default=0)
        assert counted.requests <= LIMITS.requests + len(CLIENTS)
        assert counted.rows <= max(LIMITS.rows, largest) + small

    def teardown(self) -> None:
        """Whatever happened, what is open comes to an end."""
        for _ in range(sum(ticket.rows for ticket in self.open) + 1):
            if self.running is not None:
                self.finish(0.0)
            self.start()
        assert not self.open
        assert self.policy.shares.taken == (0, 0, 0, 0.0)


TestEvents = Events.TestCase
TestEvents.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)


def run(
    policy: Policy[Ticket], now: float, row_s: dict[str, float]
) -> tuple[Slice[Ticket], float, list[Ticket]]:
    """Evaluate the next slice: the slice, the time after it, and what it completes."""
    chosen = policy.next(now)
    assert chosen is not None
    seconds = sum(rows for _, rows in chosen.pieces) * row_s[chosen.model]
    return chosen, now + seconds, policy.done(chosen, seconds)


def learned(row_s: dict[str, float], limits: Amounts = AMPLE) -> Policy[Ticket]:
    """A policy that knows what a window of each model takes."""
    policy: Policy[Ticket] = Policy(limits, 1024)
    for model in row_s:
        policy.arrive(Ticket(None, model, 256))
        run(policy, 0.0, row_s)
    return policy


@settings(max_examples=25)
@given(st.lists(st.integers(30, 900), min_size=2, max_size=6))
def test_clients_that_always_ask_get_the_same_rows(sizes: list[int]) -> None:
    policy = learned(SECONDS_A_ROW)
    served: dict[object, int] = defaultdict(int)
    now = 0.0
    for client, size in enumerate(sizes):
        for _ in range(6000 // size + 1):
            policy.arrive(Ticket(client, "fast", size, priority=Priority.BULK))
    for _ in range(12):
        chosen, now, _ = run(policy, now, SECONDS_A_ROW)
        for ticket, rows in chosen.pieces:
            served[ticket.client] += rows
    assert max(served.values()) - min(served.get(client, 0) for client in range(len(sizes))) <= 2 * 64


def test_flooders_are_refused_and_a_polite_client_is_not() -> None:
    policy = learned(SECONDS_A_ROW, Amounts(100, 20_000, 10**9, 1.0))
    refused: dict[str, int] = defaultdict(int)
    waits, now, due = [], 0.0, 0.0
    while now < 5:
        for client in ("flood 1", "flood 2", "flood 3"):
            for _ in range(20):
                refused[client] += policy.arrive(Ticket(client, "slow", 300)) is not None
        if now >= due:
            refused["polite"] += policy.arrive(Ticket("polite", "slow", 1)) is not None
            due += 0.01
            asked = now
        _, now, complete = run(policy, now, SECONDS_A_ROW)
        waits += [now - asked for ticket in complete if ticket.client == "polite"]
    assert refused.pop("polite") == 0
    assert len(waits) > 100
    assert max(waits) <= 64 * SECONDS_A_ROW["slow"] + 1e-9, "at most one slice"
    assert min(refused.values()) > 1000


def test_a_slow_model_and_a_fast_one_get_the_same_time() -> None:
    row_s = {"fast": 1e-6, "slow": 0.03}
    policy = learned(row_s)
    seconds: dict[str, float] = defaultdict(float)
    now = longest = 0.0
    while now < 10:
        for model in row_s:
            while policy.shares.of(model).requests < 50:
                policy.arrive(Ticket(model, model, 1 if model == "slow" else 1000, priority=Priority.BULK))
        before = now
        chosen, now, _ = run(policy, now, row_s)
        seconds[chosen.model] += now - before
        longest = max(longest, now - before)
    assert longest == pytest.approx(0.03)
    assert seconds["fast"] == pytest.approx(seconds["slow"], rel=0.05)


@settings(max_examples=15)
@given(st.integers(1, 64))
def test_control_goes_first_and_bulk_gets_an_eighth(rows: int) -> None:
    policy = learned(SECONDS_A_ROW)
    seconds: dict[Priority, float] = defaultdict(float)
    policy.arrive(Ticket("bulk", "slow", 65_536))
    now, control_since = 0.0, 0.0
    for _ in range(400):
        policy.arrive(Ticket("control", "slow", rows))
        before = now
        chosen, now, _ = run(policy, now, SECONDS_A_ROW)
        seconds[chosen.priority] += now - before
        if chosen.priority is Priority.BULK:
            assert control_since >= BULK_AFTER_S - 1e-9, "bulk goes before control only after its time"
            control_since = 0.0
        else:
            control_since += now - before
    if sum(seconds.values()) > 20 * BULK_AFTER_S:
        assert seconds[Priority.BULK] > 0.08 * sum(seconds.values())


def test_a_request_that_told_too_many_windows_ends() -> None:
    policy: Policy[Ticket] = Policy(LIMITS, 64)
    for told, has in ((70, 64), (70, 60), (200, 130), (3, 1)):
        ticket = Ticket("ann", "fast", told)
        assert policy.arrive(ticket) is None
        taken, ends = 0, False
        while not ends:
            chosen = policy.next(0.0)
            assert chosen is not None
            ((same, rows),) = chosen.pieces
            assert same is ticket
            if not taken:
                policy.shorten(ticket, has)
            taken += min(rows, has - taken)
            ends = ticket in policy.done(chosen, rows * SLICE_S / 64)
        assert taken == has
    assert policy.next(0.0) is None

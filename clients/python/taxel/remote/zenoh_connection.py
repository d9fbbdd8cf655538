"""A zenoh session with one server: queries that wait for their answer, and queries that do not."""

import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import count
from math import inf
from random import randrange
from typing import Any, ClassVar, Final, Literal

import zenoh
from typing_extensions import override
from zenoh.handlers import Callback, Handler

from taxel.endpoints import reason_of
from taxel.errors import (
    DeadlineExceeded,
    InvalidArgument,
    PermissionDenied,
    RequestError,
    ResourceExhausted,
    ServerLost,
    Unavailable,
)
from taxel.protocol import unpack_error
from taxel.remote.credentials import Credentials
from taxel.remote.first_reply import FirstReply
from taxel.remote.known_servers import TIMEOUT, KnownServers
from taxel.remote.open_requests import Ended, OpenRequests, not_counted
from taxel.remote.query_transport import Done, QueryTransport, nothing_to_give_up
from taxel.remote.started_query import StartedQuery
from taxel.remote.transport_watch import TransportWatch
from taxel.remote.zenoh_opening import open_client_session
from taxel.zenoh_process import close_session, leave_behind_after_fork

_AS_THEY_COME: Final = zenoh.ConsolidationMode.NONE
"""There is one answer, so it can be read before zenoh reports the end of answers."""


_NUMBERS: Final = 2**32 - 1
"""How many numbers queries have, from 1 on."""

_CANCEL_S: Final = 1.0
"""How long zenoh waits for the answer to a cancellation, which nobody reads."""


class Connection(QueryTransport):
    """A session with the server at an endpoint.

    Args:
        endpoint: where the server listens, such as `tcp/127.0.0.1:7447`.
        prefix: the server's key prefix.
        timeout: seconds to wait for the connection.
        patience: seconds that a request may wait to be sent; not less than 0.25, nor more than 5.
        shared_memory: whether large requests go through shared memory, where the server allows it.
        credentials: what the client shows to the server.

    Raises:
        InvalidArgument: that is no endpoint.
        PermissionDenied: the server turns this client away, or is not trusted.
        Unavailable: nobody listens there.
    """

    name: ClassVar[Literal["zenoh", "memory"]] = "zenoh"

    def __init__(
        self,
        endpoint: str,
        prefix: str,
        timeout: float,
        *,
        patience: float = 5.0,
        shared_memory: bool = False,
        credentials: Credentials | None = None,
    ) -> None:
        self.endpoint = endpoint
        self._process = os.getpid()
        self._session = open_client_session(
            endpoint,
            timeout,
            patience,
            shared_memory=shared_memory,
            credentials=credentials or Credentials(),
        )
        self._first_reply = FirstReply()
        self._open_requests = OpenRequests()
        self._queriers: dict[tuple[str, float], zenoh.Querier] = {}
        self._heard: dict[str, float] = {}
        """When each key was last answered, on `time.monotonic`."""
        # The server gives each session its share.
        self._id = self._session.id
        self._source = zenoh.SourceInfo(self._id, 0)
        # By its number, a query can be given up. They begin anywhere, so that others cannot guess them.
        self._numbers = count(randrange(1, _NUMBERS))
        try:
            # Its matching status tells a server that may not be asked from none.
            self._server = self._session.declare_querier(f"{prefix}/**")
        except zenoh.ZError as error:
            raise InvalidArgument(f"prefix {prefix!r}: {reason_of(error)}") from None
        self._known = KnownServers(self._session, prefix)
        self.watch: Final = TransportWatch(self._session)
        leave_behind_after_fork(self)

    def zenoh_objects(self) -> list[object]:
        """The session, and what was declared on it."""
        return [
            self._session,
            self._server,
            self._known.subscriber,
            self.watch.listener,
            *self._queriers.values(),
        ]

    @property
    @override
    def connected(self) -> bool:
        return bool(self._session.info.routers_zid()) and not self._known.gone

    def servers(self) -> tuple[str, ...]:
        """The ids of the servers that can be reached, where they tell."""
        return tuple(self._known.current())

    @property
    def is_to_router(self) -> bool:
        """Whether servers are behind a router, which is none itself."""
        servers = self._known.current()
        return bool(servers) and not any(str(zid) in servers for zid in self._session.info.routers_zid())

    @override
    def prepare(self, key: str, timeout: float) -> None:
        """Tell zenoh the key once, which makes its queries faster.

        Raises:
            Unavailable: this was closed.
        """
        if (key, timeout) not in self._queriers:
            try:
                querier = self._session.declare_querier(key, timeout=timeout, consolidation=_AS_THEY_COME)
            except zenoh.ZError as error:
                raise self._broken(error) from None
            self._queriers[key, timeout] = querier

    @override
    def start(
        self, key: str, payload: bytes | None, timeout: float, cancel_key: str | None = None
    ) -> Callable[[], bytes]:
        return self.start_polled(key, payload, timeout, cancel_key).wait

    @override
    def start_polled(
        self, key: str, payload: bytes | None, timeout: float, cancel_key: str | None = None
    ) -> StartedQuery:
        started = time.monotonic()
        ended = self._begun(payload)
        # Before the look at the transport: where that closes from here on, it ends the query.
        token = self.watch.token
        try:
            replies, source = self._sent(key, payload, timeout, cancel_key, token)
        except RequestError as error:
            ended(error)
            raise

        def settled(reply: zenoh.Reply | None, stranger: zenoh.Reply | None) -> bytes | RequestError | None:
            outcome = self._settled(reply, stranger, token, key=key, timeout=timeout, started=started)
            if outcome is not None:
                ended(outcome)
            return outcome

        def give_up() -> None:
            ended(None)
            self._give_up(cancel_key, source)

        return StartedQuery(replies, self._first_reply, settled, give_up, started + timeout)

    def _begun(self, payload: bytes | None) -> Ended:
        """What to call when a query has ended. Only those with a payload wait for the evaluation."""
        return not_counted if payload is None else self._open_requests.begin(len(payload))

    def _settled(
        self,
        reply: zenoh.Reply | None,
        stranger: zenoh.Reply | None,
        token: zenoh.CancellationToken,
        *,
        key: str,
        timeout: float,
        started: float,
    ) -> bytes | RequestError | None:
        """What a reply says, or the end of replies if it is None; None if it comes from a stranger."""
        if reply is None:
            return self._end(key, timeout, started, stranger, token)
        return self._outcome(reply, key, timeout) if self._known.answers(reply) else None

    def _sent(
        self,
        key: str,
        payload: bytes | None,
        timeout: float,
        cancel_key: str | None,
        token: zenoh.CancellationToken,
    ) -> tuple[Handler[zenoh.Reply], zenoh.SourceInfo]:
        """Send a query: where its replies come, and its name."""
        if not self.watch.is_open:
            raise self._lost(key)
        source = self._source if cancel_key is None else self._named()
        querier = self._queriers.get((key, timeout))
        try:
            if querier is not None:
                return querier.get(payload=payload, source_info=source, cancellation_token=token), source
            return self._session.get(
                key,
                payload=payload,
                timeout=timeout,
                consolidation=_AS_THEY_COME,
                source_info=source,
                cancellation_token=token,
            ), source
        except zenoh.ZError as error:
            raise self._lost(key) if self.watch.has_closed(token) else self._broken(error) from None

    @override
    def send(
        self, key: str, payload: bytes | None, timeout: float, done: Done, cancel_key: str | None = None
    ) -> Callable[[], None]:
        try:
            ended = self._begun(payload)
        except ResourceExhausted as error:
            done(error)
            return nothing_to_give_up

        def land(outcome: bytes | RequestError) -> None:
            ended(outcome)
            done(outcome)

        settle = _once(land)
        source = self._source if cancel_key is None else self._named()
        started = time.monotonic()
        stranger: zenoh.Reply | None = None
        token = self.watch.token
        if not self.watch.is_open:
            settle(self._lost(key))
            return nothing_to_give_up

        def read(reply: zenoh.Reply) -> None:
            nonlocal stranger
            if self._known.answers(reply):
                settle(self._outcome(reply, key, timeout))
            else:
                stranger = reply

        def end() -> None:
            settle(lambda: self._end(key, timeout, started, stranger, token))

        # zenoh would start a thread for each query whose callback is not direct.
        handler: Callback[zenoh.Reply] = Callback(read, end, indirect=False)
        querier = self._queriers.get((key, timeout))
        try:
            if querier is not None:
                querier.get(handler, payload=payload, source_info=source, cancellation_token=token)
            else:
                self._session.get(
                    key,
                    handler,
                    payload=payload,
                    timeout=timeout,
                    consolidation=_AS_THEY_COME,
                    source_info=source,
                    cancellation_token=token,
                )
        except zenoh.ZError as error:
            settle(self._lost(key) if self.watch.has_closed(token) else self._broken(error))
        return partial(self._give_up, cancel_key, source)

    def _named(self) -> zenoh.SourceInfo:
        """A new name for a query of this session."""
        return zenoh.SourceInfo(self._id, next(self._numbers) % _NUMBERS + 1)

    def _give_up(self, cancel_key: str | None, source: zenoh.SourceInfo) -> None:
        """Tell the server that nobody waits for the answer to the query of this name."""
        if cancel_key is None:
            return
        unread: Callback[zenoh.Reply] = Callback(_ignore, indirect=False)
        with suppress(zenoh.ZError):  # The session has ended, and its queries with it.
            self._session.get(cancel_key, unread, timeout=_CANCEL_S, source_info=source)

    @override
    def close(self) -> None:
        if self._process == os.getpid():
            close_session(self._session)

    @override
    def silence(self, key: str) -> RequestError:
        if not self.connected:
            return self._lost(key)
        # zenoh's stub takes the status for a bool.
        status: Any = self._server.matching_status
        if status.matching:
            return PermissionDenied(
                f"{self.endpoint}: a server is there, but {key} gets no answer: it does not let "
                "this client ask it; expected a user, a certificate or a network that may"
            )
        return Unavailable(
            f"{self.endpoint}: nobody answers {key}: expected a `taxel serve` with this prefix "
            "that this client may know of"
        )

    def _lost(self, key: str) -> ServerLost:
        return ServerLost(
            f"{self.endpoint}: nobody answers {key}: the connection to the server was lost; "
            "it is connected again by itself once a `taxel serve` listens there"
        )

    def _outcome(self, reply: zenoh.Reply, key: str, wait: float) -> bytes | RequestError:
        """The answer that a reply holds, or the error."""
        if reply.ok is not None:
            self._heard[key] = time.monotonic()
            return reply.ok.payload.to_bytes()
        text = reply.err.payload.to_bytes() if reply.err is not None else b""
        if text == TIMEOUT:
            return self._late(key, wait)
        self._heard[key] = time.monotonic()
        return unpack_error(text)

    def _end(
        self,
        key: str,
        wait: float,
        started: float,
        stranger: zenoh.Reply | None,
        token: zenoh.CancellationToken,
    ) -> RequestError:
        """The error of a query that ended without a server's reply."""
        if stranger is not None:
            return Unavailable(
                f"{self.endpoint}: {key} was answered by {stranger.replier_id}, which is no server of this "
                "prefix: its answer was refused; see who may declare keys on the way to the server"
            )
        if time.monotonic() - started >= wait:
            return self._late(key, wait)
        if self.watch.has_closed(token) or self._known.lost_at >= started:
            # It may be connected again by now.
            return ServerLost(
                f"{self.endpoint}: nobody answers {key}: the connection to the server was lost"
            )
        if self._heard.get(key, -inf) > self._known.lost_at:
            # Answers are dropped before the connection ends.
            return ServerLost(
                f"{self.endpoint}: the answer to {key} was lost, as its connection is being lost: "
                "a server disconnects clients that do not read their answers"
            )
        return self.silence(key)

    def _late(self, key: str, wait: float) -> DeadlineExceeded:
        return DeadlineExceeded(f"{self.endpoint}: no answer to {key} within {wait:g} s")

    def _broken(self, error: zenoh.ZError) -> Unavailable:
        return Unavailable(f"{self.endpoint}: {reason_of(error)}")


def _ignore(_: zenoh.Reply) -> None: ...


def _once(done: Done) -> Callable[[bytes | RequestError | Callable[[], RequestError]], None]:
    """A function that passes on the first outcome, computed if it is a function, and ignores others."""
    settled = False

    def settle(outcome: bytes | RequestError | Callable[[], RequestError]) -> None:
        nonlocal settled
        if not settled:
            settled = True
            done(outcome() if callable(outcome) else outcome)

    return settle

"""A zenoh session with one server: queries that wait for their answer, and queries that do not."""

import json
import os
import time
from collections.abc import Callable
from typing import Any, ClassVar, Final, Literal

import zenoh
from typing_extensions import override
from zenoh.handlers import Callback

from taxel.endpoints import checked_endpoint, reason_of
from taxel.errors import (
    DeadlineExceeded,
    InvalidArgument,
    PermissionDenied,
    RequestError,
    ServerLost,
    Unavailable,
)
from taxel.protocol import unpack_error
from taxel.remote.query_transport import Done, QueryTransport
from taxel.zenoh_process import leave_behind_after_fork, open_session

_AS_THEY_COME: Final = zenoh.ConsolidationMode.NONE
"""There is one answer, so it can be read before zenoh reports the end of answers."""

_RETRY: Final = {"period_init_ms": 100, "period_max_ms": 400, "period_increase_factor": 2}
"""When zenoh looks again for a server that was lost. By default it waits 1 s and longer."""


class Connection(QueryTransport):
    """A session with the server at an endpoint.

    Args:
        endpoint: where the server listens, such as `tcp/127.0.0.1:7447`.
        prefix: the server's key prefix.
        timeout: seconds to wait for the connection.
        shared_memory: whether large requests go through shared memory, where the server allows it.

    Raises:
        InvalidArgument: that is no endpoint.
        Unavailable: nobody listens there.
    """

    name: ClassVar[Literal["zenoh", "memory"]] = "zenoh"

    def __init__(self, endpoint: str, prefix: str, timeout: float, *, shared_memory: bool = False) -> None:
        self.endpoint = endpoint
        self._process = os.getpid()
        self._session = _open(endpoint, timeout, shared_memory)
        self._queriers: dict[tuple[str, float], zenoh.Querier] = {}
        try:
            # Its matching status tells a server that may not be asked from none.
            self._server = self._session.declare_querier(f"{prefix}/**")
        except zenoh.ZError as error:
            raise InvalidArgument(f"prefix {prefix!r}: {reason_of(error)}") from None
        leave_behind_after_fork(self)

    def zenoh_objects(self) -> list[object]:
        """The session, and what was declared on it."""
        return [self._session, self._server, *self._queriers.values()]

    @property
    @override
    def connected(self) -> bool:
        return bool(self._session.info.routers_zid())

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
    def start(self, key: str, payload: bytes | None, timeout: float) -> Callable[[], bytes]:
        started = time.monotonic()
        querier = self._queriers.get((key, timeout))
        try:
            if querier is not None:
                replies = querier.get(payload=payload)
            else:
                replies = self._session.get(
                    key, payload=payload, timeout=timeout, consolidation=_AS_THEY_COME
                )
        except zenoh.ZError as error:
            raise self._broken(error) from None

        def answer() -> bytes:
            reply = next(iter(replies), None)
            outcome = self._outcome(reply, key, timeout) if reply else self._end(key, timeout, started)
            if isinstance(outcome, RequestError):
                raise outcome
            return outcome

        return answer

    @override
    def send(self, key: str, payload: bytes | None, timeout: float, done: Done) -> None:
        settle = _once(done)
        started = time.monotonic()

        def read(reply: zenoh.Reply) -> None:
            settle(self._outcome(reply, key, timeout))

        def end() -> None:
            settle(lambda: self._end(key, timeout, started))

        # zenoh would start a thread for each query whose callback is not direct.
        handler: Callback[zenoh.Reply] = Callback(read, end, indirect=False)
        querier = self._queriers.get((key, timeout))
        try:
            if querier is not None:
                querier.get(handler, payload=payload)
            else:
                self._session.get(
                    key, handler, payload=payload, timeout=timeout, consolidation=_AS_THEY_COME
                )
        except zenoh.ZError as error:
            settle(self._broken(error))

    @override
    def close(self) -> None:
        if self._process == os.getpid():
            self._session.close()  # type: ignore[no-untyped-call]

    @override
    def silence(self, key: str) -> RequestError:
        if not self.connected:
            return ServerLost(
                f"{self.endpoint}: nobody answers {key}: the connection to the server was lost; "
                "it is connected again by itself once a `taxel serve` listens there"
            )
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

    def _outcome(self, reply: zenoh.Reply, key: str, wait: float) -> bytes | RequestError:
        """The answer that a reply holds, or the error."""
        if reply.ok is not None:
            return reply.ok.payload.to_bytes()
        text = reply.err.payload.to_bytes() if reply.err is not None else b""
        return self._late(key, wait) if text == b"Timeout" else unpack_error(text)

    def _end(self, key: str, wait: float, started: float) -> RequestError:
        """The error of a query that ended without a reply."""
        return self._late(key, wait) if time.monotonic() - started >= wait else self.silence(key)

    def _late(self, key: str, wait: float) -> DeadlineExceeded:
        return DeadlineExceeded(f"{self.endpoint}: no answer to {key} within {wait:g} s")

    def _broken(self, error: zenoh.ZError) -> Unavailable:
        return Unavailable(f"{self.endpoint}: {reason_of(error)}")


def _once(done: Done) -> Callable[[bytes | RequestError | Callable[[], RequestError]], None]:
    """A function that passes on the first outcome, computed if it is a function, and ignores others."""
    settled = False

    def settle(outcome: bytes | RequestError | Callable[[], RequestError]) -> None:
        nonlocal settled
        if not settled:
            settled = True
            done(outcome() if callable(outcome) else outcome)

    return settle


def _open(endpoint: str, timeout: float, shared_memory: bool) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", json.dumps(shared_memory))
    config.insert_json5("connect/timeout_ms", str(round(timeout * 1e3)))
    config.insert_json5("connect/exit_on_failure", "true")
    config.insert_json5("connect/retry", json.dumps(_RETRY))
    try:
        config.insert_json5("connect/endpoints", json.dumps([checked_endpoint(endpoint)]))
    except zenoh.ZError as error:
        raise InvalidArgument(f"endpoint {endpoint!r}: {reason_of(error)}") from None
    try:
        return open_session(config)
    except zenoh.ZError as error:
        raise Unavailable(
            f"no server at {endpoint} within {timeout:g} s; expected a `taxel serve` that has printed"
            f" 'listening on': {reason_of(error)}"
        ) from None

"""A zenoh session with one server: queries that wait for their answer, and queries that do not."""

import json
import time
from collections.abc import Callable
from typing import Final

import numpy as np
import zenoh
from zenoh.handlers import Callback

from taxel.endpoints import EXPECTED, reason_of
from taxel.errors import DeadlineExceeded, InvalidArgument, RequestError, Unavailable
from taxel.protocol import unpack_error

Done = Callable[[bytes | RequestError], None]
"""Called with the result of a query."""

_AS_THEY_COME: Final = zenoh.ConsolidationMode.NONE
"""There is one answer, so it can be read before zenoh reports the end of answers."""


_LOOK_AGAIN_S: Final = 0.01
_DECLARED_S: Final = 0.05


class ServerLost(Unavailable):
    """The connection to the server was lost before the answer was there."""


class Connection:
    """Queries the keys of a server; each query has one answer. Thread-safe.

    Args:
        endpoint: where the server listens, such as `tcp/127.0.0.1:7447`.
        timeout: seconds to wait for the connection, and for an answer if a call gives no timeout.
        shared_memory: whether large requests go through shared memory, where the server allows it.

    Raises:
        InvalidArgument: that is no endpoint.
        Unavailable: nobody listens there.
    """

    def __init__(self, endpoint: str, timeout: float, *, shared_memory: bool = False) -> None:
        self.endpoint = endpoint
        self.timeout = checked_timeout(timeout)
        self._session = _open(endpoint, timeout, shared_memory)
        # The server gives each session its share.
        self._source = zenoh.SourceInfo(self._session.id, 0)

    def get(self, key: str, payload: bytes | None = None, timeout: float | None = None) -> bytes:
        """One query, one answer.

        Raises:
            RequestError: the server's typed error; `Unavailable` if nobody answers,
                `DeadlineExceeded` if the answer does not come in time.
        """
        wait = self.timeout if timeout is None else timeout
        return self._sent(
            key,
            wait,
            lambda: self._session.get(
                key, payload=payload, timeout=wait, consolidation=_AS_THEY_COME, source_info=self._source
            ),
        )()

    def asker(self, key: str, wait: float) -> Callable[[bytes], bytes]:
        """A function that queries one key. It is faster than `get`: zenoh learns the key once.

        Args:
            key: the key to query.
            wait: seconds to wait for each answer.

        Raises:
            Unavailable: this source was closed.
        """
        ask = self.pipelined_asker(key, wait)
        return lambda payload: ask(payload)()

    def pipelined_asker(self, key: str, wait: float) -> Callable[[bytes], Callable[[], bytes]]:
        """Like `asker`, but a query returns at once. It returns a function that waits for the answer, once.

        Raises:
            Unavailable: this source was closed.
        """
        try:
            querier = self._session.declare_querier(key, timeout=wait, consolidation=_AS_THEY_COME)
        except zenoh.ZError as error:
            raise self._broken(error) from None
        return lambda payload: self._sent(
            key, wait, lambda: querier.get(payload=payload, source_info=self._source)
        )

    def send(self, key: str, payload: bytes, done: Done) -> None:
        """Send one query without waiting. Any number of such queries may be in flight.

        Args:
            key: the key to query.
            payload: the content of the query.
            done: called exactly once with the answer, or with the error that `get` would raise. It is
                called on zenoh's network thread, so it must return quickly.
        """
        settle = _once(done)
        started = time.monotonic()

        def read(reply: zenoh.Reply) -> None:
            settle(self._outcome(reply, key, self.timeout))

        def end() -> None:
            settle(self._silence(key, self.timeout, started))

        # zenoh would start a thread for each query whose callback is not direct.
        handler: Callback[zenoh.Reply] = Callback(read, end, indirect=False)
        try:
            self._session.get(
                key,
                handler,
                payload=payload,
                timeout=self.timeout,
                consolidation=_AS_THEY_COME,
                source_info=self._source,
            )
        except zenoh.ZError as error:
            settle(self._broken(error))

    def close(self) -> None:
        """End the session. Later queries raise `Unavailable`."""
        self._session.close()  # type: ignore[no-untyped-call]

    def _sent(
        self, key: str, wait: float, send: Callable[[], zenoh.handlers.Handler[zenoh.Reply]]
    ) -> Callable[[], bytes]:
        """Send a query at once and return a function that waits for its one answer."""
        started = time.monotonic()
        try:
            replies = send()
        except zenoh.ZError as error:
            raise self._broken(error) from None

        def answer() -> bytes:
            reply = next(iter(replies), None)
            if reply is None:
                raise self._silence(key, wait, started)
            outcome = self._outcome(reply, key, wait)
            if isinstance(outcome, RequestError):
                raise outcome
            return outcome

        return answer

    def _outcome(self, reply: zenoh.Reply, key: str, wait: float) -> bytes | RequestError:
        """The answer that a reply holds, or the error."""
        if reply.ok is not None:
            return reply.ok.payload.to_bytes()
        text = reply.err.payload.to_bytes() if reply.err is not None else b""
        return self._late(key, wait) if text == b"Timeout" else unpack_error(text)

    def _silence(self, key: str, wait: float, started: float) -> RequestError:
        """The error of a query that ended without a reply."""
        if time.monotonic() - started >= wait:
            return self._late(key, wait)
        if not self._connected():
            return ServerLost(
                f"{self.endpoint}: nobody answers {key}: the connection to the server was lost; "
                "zenoh connects again by itself once a `taxel serve` listens there"
            )
        return Unavailable(
            f"{self.endpoint}: nobody answers {key}: expected a `taxel serve` with this prefix "
            "that lets this client ask"
        )

    def connected_again(self, within: float) -> bool:
        """Wait until zenoh has connected again after `ServerLost`; whether it has.

        Args:
            within: the most seconds to wait.
        """
        ends = time.monotonic() + within
        while not self._connected():
            if time.monotonic() + _LOOK_AGAIN_S > ends:
                return False
            time.sleep(_LOOK_AGAIN_S)
        # The server's key becomes known just after the connection.
        time.sleep(min(_DECLARED_S, max(ends - time.monotonic(), 0)))
        return True

    def _connected(self) -> bool:
        return bool(self._session.info.routers_zid())

    def _late(self, key: str, wait: float) -> DeadlineExceeded:
        return DeadlineExceeded(f"{self.endpoint}: no answer to {key} within {wait:g} s")

    def _broken(self, error: zenoh.ZError) -> Unavailable:
        return Unavailable(f"{self.endpoint}: {error}")


def checked_timeout(timeout: float) -> float:
    """A timeout in seconds.

    Raises:
        InvalidArgument: it is not a positive, finite number.
    """
    if not (np.isfinite(timeout) and timeout > 0):
        raise InvalidArgument(f"timeout is {timeout!r}: expected seconds above 0")
    return timeout


def _once(done: Done) -> Done:
    """A function that passes on the first outcome and ignores all others."""
    settled = False

    def settle(outcome: bytes | RequestError) -> None:
        nonlocal settled
        if not settled:
            settled = True
            done(outcome)

    return settle


def _open(endpoint: str, timeout: float, shared_memory: bool) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", json.dumps(shared_memory))
    config.insert_json5("connect/timeout_ms", str(round(timeout * 1e3)))
    config.insert_json5("connect/exit_on_failure", "true")
    try:
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    except zenoh.ZError:
        raise InvalidArgument(f"endpoint {endpoint!r}: {EXPECTED}") from None
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise Unavailable(
            f"no server at {endpoint} within {timeout:g} s; expected a `taxel serve` that has printed"
            f" 'listening on': {reason_of(error)}"
        ) from None

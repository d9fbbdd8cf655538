"""A connection that sends queries without waiting for the answers to earlier ones."""

from collections.abc import Callable

import zenoh
from zenoh.handlers import Callback

from taxel.errors import DeadlineExceeded, RequestError, Unavailable
from taxel.protocol import unpack_error
from taxel.remote import RemoteSource

Done = Callable[[bytes | RequestError], None]


class Sender(RemoteSource):
    """A `RemoteSource` that may have any number of queries in flight."""

    def send(self, key: str, payload: bytes, done: Done) -> None:
        """Send one query and return at once.

        Args:
            done: called exactly once with the answer or the error, on zenoh's network thread,
                which it must not hold up.
        """
        settled = False

        def settle(result: bytes | RequestError) -> None:
            nonlocal settled
            if not settled:
                settled = True
                done(result)

        def end() -> None:
            settle(Unavailable(f"{self.endpoint}: nobody answers {key}"))

        # zenoh would start a thread for each query whose callback is not direct.
        handler: Callback[zenoh.Reply] = Callback(lambda reply: settle(_result(reply)), end, indirect=False)
        try:
            self._session.get(key, handler, payload=payload, timeout=self.timeout)
        except zenoh.ZError as error:
            settle(Unavailable(f"{self.endpoint}: {error}"))


def _result(reply: zenoh.Reply) -> bytes | RequestError:
    if reply.ok is not None:
        return reply.ok.payload.to_bytes()
    text = reply.err.payload.to_bytes() if reply.err is not None else b""
    return DeadlineExceeded("no answer in time") if text == b"Timeout" else unpack_error(text)

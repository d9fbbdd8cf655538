"""A query over zenoh that is on its way, and the wait for its one answer."""

import time
from collections.abc import Callable

import zenoh
from zenoh.handlers import Handler

from taxel.errors import DeadlineExceeded, RequestError
from taxel.remote.first_reply import FirstReply


class StartedQuery:
    """A query whose replies come into a channel.

    Args:
        replies: the channel.
        first_reply: waits at it.
        settled: what a reply, or the end of replies, says, given the stranger that has replied.
        give_up: tells the server that nobody waits any more.
        ends: when its time is over.
    """

    def __init__(
        self,
        replies: Handler[zenoh.Reply],
        first_reply: FirstReply,
        settled: Callable[[zenoh.Reply | None, zenoh.Reply | None], bytes | RequestError | None],
        give_up: Callable[[], None],
        ends: float,
    ) -> None:
        self._replies = replies
        self._first_reply = first_reply
        self._settled = settled
        self._ends = ends
        self._stranger: zenoh.Reply | None = None
        self.give_up = give_up

    def wait(self) -> bytes:
        """The answer; raises as the function that `QueryTransport.start` returns."""
        try:
            while (answer := self._taken(self._first_reply.wait(self._replies))) is None:
                pass
        except RequestError:
            raise
        except BaseException:
            # Ctrl-C, most likely.
            self.give_up()
            raise
        return answer

    def look(self) -> bytes | None:
        """The answer, if it is there; raises as `wait`."""
        try:
            reply = self._replies.try_recv()
        except zenoh.ZError:
            return self._taken(None)
        return None if reply is None else self._taken(reply)

    def _taken(self, reply: zenoh.Reply | None) -> bytes | None:
        outcome = self._settled(reply, self._stranger)
        if isinstance(outcome, RequestError):
            # The server's own comes earlier.
            if isinstance(outcome, DeadlineExceeded) and time.monotonic() >= self._ends:
                self.give_up()
            try:
                raise outcome
            finally:
                # The error holds this frame. A variable that holds the error keeps both until a collection.
                del outcome
        if outcome is None:
            self._stranger = reply
        return outcome

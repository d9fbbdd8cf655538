"""Asks one of several servers, and another one if it fails or is silent, within the request's time."""

import time
from typing import Any, Final

from taxel.errors import DeadlineExceeded, PermissionDenied, RequestError, ResourceExhausted, Unavailable
from taxel.remote.replicas import Replica, Replicas
from taxel.remote.waiting import Waiting

_PATIENCE: Final = 8
_LEAST_PATIENCE_S: Final = 0.1
"""A server is silent if an answer takes this many times its recent latency, and this long at least."""

_LARGE: Final = 2**18
"""A request of more bytes takes longer than the others, so that their latency says nothing of it."""

_EARLY: Final = 10.0
_EARLY_SHARE: Final = 0.1
"""How many requests may turn away early from a silent server: so many at once, and this share of all.
Else a time when all servers are slow would double what they are asked."""

_LOOK_AGAIN_S: Final = 0.01
_WAIT_S: Final = 2.0
"""How often, and how long, a request looks for a server while there is none."""

_DECLARED_S: Final = 0.2
"""How soon after a server its own keys are known: until then, it seems to deny them."""


class Failover:
    """Asks replicas. One serves all requests of a client.

    Attributes:
        repeated: how often a question went to another server.
    """

    def __init__(self, replicas: Replicas) -> None:
        self.replicas = replicas
        self.repeated = 0
        self._early = _EARLY

    async def ask(
        self,
        waiting: Waiting[Any],
        key: str,
        payload: bytes | None,
        timeout: float,
        cancel_key: str | None = None,
    ) -> bytes:
        """The one answer to a question. A server that is not waited for any longer is told so.

        Raises:
            RequestError: as `QueryTransport.start`; of the last server that was asked.
        """
        began = time.monotonic()
        ends = began + timeout
        self._early = min(self._early + _EARLY_SHARE, _EARLY)
        tried: set[str] = set()
        error: RequestError | None = None
        while (left := ends - time.monotonic()) > 0:
            choice = self.replicas.choose(tried)
            if choice is None:
                if time.monotonic() - began > _worth_waiting(error):
                    break
                # Servers that end, or start, and their keys, are known of a moment later.
                await waiting.sleep(min(_LOOK_AGAIN_S, left))
                tried.clear()
                continue
            replica = choice.replica
            tried.add(replica.server)
            patience = left if choice.last else self._patience(replica, payload, left)
            try:
                return await self._ask_one(waiting, replica, key, payload, patience, cancel_key)
            except DeadlineExceeded as late:
                if choice.last or ends - time.monotonic() <= 0:
                    raise
                self._early -= 1
                error = late
            except (Unavailable, PermissionDenied, ResourceExhausted) as refusal:
                error = refusal
            self.repeated += 1
        raise error or self.replicas.silence(key)

    def _patience(self, replica: Replica, payload: bytes | None, left: float) -> float:
        """How long to wait for a server while there are others."""
        if self._early < 1 or (payload is not None and len(payload) > _LARGE):
            return left / 2
        return min(max(_PATIENCE * replica.load.latency_s, _LEAST_PATIENCE_S), left / 2)

    async def _ask_one(
        self,
        waiting: Waiting[Any],
        replica: Replica,
        key: str,
        payload: bytes | None,
        timeout: float,
        cancel_key: str | None,
    ) -> bytes:
        began = time.monotonic()
        answered = False
        replica.asked()
        try:
            own_cancel = None if cancel_key is None else replica.key(cancel_key)
            answer = await waiting.ask(replica.connection, replica.key(key), payload, timeout, own_cancel)
            answered = True
            return answer
        finally:
            replica.done(time.monotonic() - began, answered=answered)


def _worth_waiting(error: RequestError | None) -> float:
    """How long it may help to ask all again, s."""
    if error is None or isinstance(error, Unavailable):
        return _WAIT_S
    return _DECLARED_S if isinstance(error, PermissionDenied) else 0.0

"""Refused requests: counted by code and client, and logged, one line for each kind and client in 10 s."""

import logging
import time
from collections import Counter, OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Final, NamedTuple

from taxel.errors import RequestError

_LOG: Final = logging.getLogger("taxel_server.refusals")

_WHILE_S: Final = 10.0
"""A kind of refusal of one client is logged at most once in so many seconds."""

_MOST_CLIENTS: Final = 256
"""Clients that are counted, and kinds that are remembered; a stranger must not fill the memory."""

OTHERS: Final = "others"
"""The clients beyond those that are counted by name."""


class _Logged(NamedTuple):
    at: float
    suppressed: int


class Refusals:
    """Refused and failed requests since the server started. Thread-safe.

    Args:
        clock: seconds that never go back.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = Lock()
        self._counts: Counter[tuple[str, str]] = Counter()
        self._clients: set[str] = set()
        self._logged: OrderedDict[tuple[str, str, str], _Logged] = OrderedDict()

    def add(
        self,
        error: RequestError,
        *,
        client: str,
        model: str = "",
        request_id: str | int | None = None,
        trace_id: str | None = None,
    ) -> None:
        """Count a refusal; log it unless its kind was logged a short while ago for the same client.

        Args:
            error: what the client was told.
            client: who asked, as far as its transport knows.
            model: name and version.
            request_id: the request's own id, where it is known.
            trace_id: of the trace that it belongs to, if the client told one.
        """
        now = self._clock()
        with self._lock:
            if client not in self._clients and len(self._clients) < _MOST_CLIENTS:
                self._clients.add(client)
            named = client if client in self._clients else OTHERS
            self._counts[error.code, named] += 1
            kind = (error.code, named, model)
            before = self._logged.get(kind)
            if before is not None and now - before.at < _WHILE_S:
                self._logged[kind] = _Logged(before.at, before.suppressed + 1)
                return
            self._logged[kind] = _Logged(now, 0)
            self._logged.move_to_end(kind)
            if len(self._logged) > _MOST_CLIENTS:
                self._logged.popitem(last=False)
        fields: dict[str, str | int | None] = {
            "code": error.code,
            "client": client,
            "model": model,
            "request_id": request_id,
            "trace_id": trace_id,
        }
        if before is not None and before.suppressed:
            fields["suppressed"] = before.suppressed
        _LOG.warning(
            "refused: %s",
            error,
            extra={"fields": {name: value for name, value in fields.items() if value not in (None, "")}},
        )

    def counts(self) -> list[tuple[str, str, int]]:
        """Code, client and number of every kind."""
        with self._lock:
            return [(code, client, count) for (code, client), count in sorted(self._counts.items())]

"""The metadata thread: it answers every query that needs no evaluation, and sends refusals."""

import logging
from collections.abc import Callable
from queue import SimpleQueue
from threading import Thread
from typing import Any, Final

import zenoh

from taxel.errors import Internal, RequestError, ResourceExhausted, Unavailable
from taxel.protocol import packb
from taxel_server.transports.outgoing import reply

_LOG: Final = logging.getLogger(__name__)

_MAX_QUEUED: Final = 4096
"""The most queries that wait for this thread."""


class MetadataThread:
    """Answers queries by their key, in the order of their arrival.

    Args:
        answer: the answer to a key; raises `RequestError` to refuse.
        take_order: answers a key with a payload later, or returns False at once.
        refused: is told what `answer` refused.
    """

    def __init__(
        self,
        answer: Callable[[str], dict[str, Any]],
        take_order: Callable[[str, bytes, Callable[[bytes | RequestError], None]], bool],
        refused: Callable[[RequestError], None],
    ) -> None:
        self._answer = answer
        self._take_order = take_order
        self._refused = refused
        self._queue: SimpleQueue[tuple[zenoh.Query, RequestError | None] | None] = SimpleQueue()
        self._thread = Thread(target=self._run, name="taxel-metadata", daemon=True)

    def start(self) -> None:
        """Start answering."""
        self._thread.start()

    def take(self, query: zenoh.Query, refusal: RequestError | None = None) -> None:
        """Queue a query for its answer, or for a refusal already decided; returns at once."""
        if self._queue.qsize() < _MAX_QUEUED:
            self._queue.put((query, refusal))
        else:
            reply(query, ResourceExhausted("too many queries are waiting; try again later"))

    def close(self) -> None:
        """Answer the queued queries and stop; later queries are refused."""
        self._queue.put(None)
        self._thread.join()
        while not self._queue.empty():
            if (item := self._queue.get()) is not None:
                reply(item[0], Unavailable("the server is stopping"))

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            query, refusal = item
            try:
                if refusal is not None or not self._orders(query):
                    reply(query, refusal or self._result(str(query.key_expr)))
            except Exception:
                # The thread must survive a query that cannot be answered.
                _LOG.exception("an answer could not be given")

    def _orders(self, query: zenoh.Query) -> bool:
        """Whether a query is an order, which is answered when it is done."""
        payload = query.payload

        def answer(result: bytes | RequestError) -> None:
            if isinstance(result, RequestError):
                self._refused(result)
            reply(query, result)

        return self._take_order(str(query.key_expr), payload.to_bytes() if payload else b"", answer)

    def _result(self, key: str) -> bytes | RequestError:
        try:
            return packb(self._answer(key))
        except RequestError as error:
            self._refused(error)
            return error
        except Exception:
            _LOG.exception("%s could not be answered", key)
            return Internal(f"{key} could not be answered: the server's log says more")

"""Asks a Taxel server over zenoh, one query at a time by the predictor that a user would hold."""

from collections import deque
from collections.abc import Iterator

import numpy as np
import zenoh
from numpy.typing import NDArray
from typing_extensions import override

from taxel.protocol import model_key, pack_infer_request, unpack_error, unpack_infer_response
from taxel.remote import RemoteSource

from .client import Client, client_arguments, obey


class PipelinedSource(RemoteSource):
    """A `RemoteSource` that sends a query without waiting for the answers to earlier ones."""

    def querier(self, key: str) -> zenoh.Querier:
        """What sends queries to a key, as a `RemotePredictor` does."""
        return self._session.declare_querier(
            key, timeout=self.timeout, consolidation=zenoh.ConsolidationMode.NONE
        )


class TaxelClient(Client):
    """One session, as any of Taxel's clients has."""

    def __init__(self, source: PipelinedSource) -> None:
        (model,) = source.models()
        self._predictor = source.predictor(model.name, model.version)
        self._timeout_ms = source.timeout * 1e3
        self._querier = source.querier(model_key(source.prefix, model.name, model.version, "infer"))

    @override
    def connect(self, at_once: int) -> None:
        """Nothing: the session stays open."""

    @override
    def ask(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        return self._predictor.predict(windows)

    @override
    def ask_many(self, queries: Iterator[NDArray[np.float32]], at_once: int) -> int:
        answered = 0
        on_their_way: deque[zenoh.handlers.Handler[zenoh.Reply]] = deque()
        for query in queries:
            if len(on_their_way) == at_once:
                _read(on_their_way.popleft())
                answered += 1
            payload = pack_infer_request(query, timeout_ms=self._timeout_ms)
            on_their_way.append(self._querier.get(payload=payload))
        for replies in on_their_way:
            _read(replies)
        return answered + len(on_their_way)


def _read(replies: zenoh.handlers.Handler[zenoh.Reply]) -> NDArray[np.float32]:
    reply = replies.recv()
    if reply.ok is None:
        raise unpack_error(reply.err.payload.to_bytes() if reply.err is not None else b"")
    return unpack_infer_response(reply.ok.payload.to_bytes()).outputs


def main() -> None:
    """Obey until stdin ends."""
    arguments = client_arguments()
    with PipelinedSource(f"tcp/{arguments.address}:{arguments.port}") as source:
        obey(TaxelClient(source), arguments.windows)


if __name__ == "__main__":
    main()

"""Asks a Taxel server over zenoh, one query at a time by the predictor that a user would hold."""

from collections import deque
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.protocol import model_key, pack_infer_request, unpack_infer_response
from taxel.remote import RemoteSource

from .client import Client, client_arguments, obey


class TaxelClient(Client):
    """One session, as any of Taxel's clients has."""

    def __init__(self, source: RemoteSource) -> None:
        (model,) = source.models()
        self._predictor = source.predictor(model.name, model.version)
        self._timeout_ms = source.timeout * 1e3
        key = model_key(source.prefix, model.name, model.version, "infer")
        self._ask = source.pipelined_asker(key, source.timeout)

    @override
    def connect(self, at_once: int) -> None:
        """Nothing: the session stays open."""

    @override
    def ask(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        return self._predictor.predict(windows)

    @override
    def ask_many(self, queries: Iterator[NDArray[np.float32]], at_once: int) -> int:
        answered = 0
        on_their_way: deque[Callable[[], bytes]] = deque()
        for query in queries:
            if len(on_their_way) == at_once:
                unpack_infer_response(on_their_way.popleft()())
                answered += 1
            payload = pack_infer_request(query, timeout_ms=self._timeout_ms)
            on_their_way.append(self._ask(payload))
        for answer in on_their_way:
            unpack_infer_response(answer())
        return answered + len(on_their_way)


def main() -> None:
    """Obey until stdin ends."""
    arguments = client_arguments()
    with RemoteSource(f"tcp/{arguments.address}:{arguments.port}") as source:
        obey(TaxelClient(source), arguments.windows)


if __name__ == "__main__":
    main()

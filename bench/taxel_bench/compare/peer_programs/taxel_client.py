"""Asks a Taxel server over zenoh or its lane; one query at a time by a user's predictor."""

from collections import deque
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.lane.connection import LaneConnection
from taxel.lane.frames import read_counts
from taxel.protocol import model_key, model_path, pack_infer_request, unpack_infer_response
from taxel.remote import RemoteSource

from .client import Client, client_arguments, obey


class TaxelClient(Client):
    """One session, as any of Taxel's clients has."""

    def __init__(self, source: RemoteSource) -> None:
        (model,) = source.models()
        self._predictor = source.predictor(model.name, model.version)
        self._timeout_ms = source.timeout * 1e3
        self._key = model_key(source.prefix, model.name, model.version, "infer")
        self._connection = source.connection
        self._connection.prepare(self._key, source.timeout)

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
            on_their_way.append(self._connection.start(self._key, payload, self._timeout_ms / 1e3))
        for answer in on_their_way:
            unpack_infer_response(answer())
        return answered + len(on_their_way)


class LaneClient(TaxelClient):
    """The same over the server's lane."""

    def __init__(self, source: RemoteSource) -> None:
        super().__init__(source)
        manifest = self._predictor.manifest
        self._path = model_path(manifest.name, manifest.version, "infer")
        self._timeout_s = source.timeout
        assert source.lane_address is not None
        self._lane = LaneConnection(source.lane_address)

    @override
    def ask_many(self, queries: Iterator[NDArray[np.float32]], at_once: int) -> int:
        answered = on_their_way = 0
        for query in queries:
            if on_their_way == at_once:
                self._take_answer()
                answered += 1
            else:
                on_their_way += 1
            self._lane.send(self._path, query, self._timeout_s, self._timeout_s, spread=False)
        for _ in range(on_their_way):
            self._take_answer()
        return answered + on_their_way

    def _take_answer(self) -> None:
        head, content = self._lane.receive(self._timeout_s)
        read_counts(content, head)


def main() -> None:
    """Obey until stdin ends."""
    parser = client_arguments()
    parser.add_argument("--transport", required=True, choices=("zenoh", "lane"))
    arguments = parser.parse_args()
    endpoint = f"tcp/{arguments.address}:{arguments.port}"
    with RemoteSource(endpoint, transport=arguments.transport) as source:
        client = (LaneClient if arguments.transport == "lane" else TaxelClient)(source)
        obey(client, arguments.windows)


if __name__ == "__main__":
    main()

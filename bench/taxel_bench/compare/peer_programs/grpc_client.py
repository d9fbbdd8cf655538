"""Asks over gRPC on one channel, as gRPC recommends, without protobuf messages."""

from collections import deque
from collections.abc import Iterator

import grpc  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

from .client import Client, client_arguments, counts_of, obey
from .grpc_server import METHOD, SERVICE


class GrpcClient(Client):
    """One channel; queries on their way are gRPC's futures."""

    def __init__(self, address: str, port: int) -> None:
        self._call = grpc.insecure_channel(f"{address}:{port}").unary_unary(f"/{SERVICE}/{METHOD}")

    def connect(self, at_once: int) -> None:
        """Nothing: gRPC keeps its one channel open."""

    def ask(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        """See `Client`."""
        return counts_of(self._call(windows.tobytes()))

    def ask_many(self, queries: Iterator[NDArray[np.float32]], at_once: int) -> int:
        """See `Client`."""
        answered = 0
        on_their_way: deque[grpc.Future] = deque()
        for query in queries:
            if len(on_their_way) == at_once:
                counts_of(on_their_way.popleft().result())
                answered += 1
            on_their_way.append(self._call.future(query.tobytes()))
        for future in on_their_way:
            counts_of(future.result())
        return answered + len(on_their_way)


def main() -> None:
    """Obey until stdin ends."""
    arguments = client_arguments().parse_args()
    obey(GrpcClient(arguments.address, arguments.port), arguments.windows)


if __name__ == "__main__":
    main()

"""mosec with one worker process: raw bytes in, raw bytes out."""

from mosec import Server, Worker  # type: ignore[import-not-found]

from .network import Network, server_arguments


class NetworkWorker(Worker):  # type: ignore[misc]
    """The network in mosec's worker process, which sees the same command line."""

    def __init__(self) -> None:
        super().__init__()
        self._network = Network(server_arguments().model)

    def deserialize(self, data: bytes) -> bytes:
        """The windows as they came."""
        return data

    def forward(self, data: bytes) -> bytes:
        """The counts."""
        return self._network.predict(data)

    def serialize(self, data: bytes) -> bytes:
        """The counts as they are."""
        return data


def main() -> None:
    """Serve until terminated; mosec reads `--port` and `--address` off the command line itself."""
    server = Server()
    server.append_worker(NetworkWorker, route="/predict")
    server.run()


if __name__ == "__main__":
    main()

"""LitServe with one worker process: raw bytes in, raw bytes out."""

from typing import Annotated

import litserve  # type: ignore[import-not-found]
from fastapi import Body, Response  # type: ignore[import-not-found]

from .network import Network, server_arguments


class NetworkApi(litserve.LitAPI):  # type: ignore[misc]
    """The network behind LitServe's four steps."""

    def __init__(self, model: str) -> None:
        super().__init__()
        self._model = model

    def setup(self, device: str) -> None:
        """Load the network in the worker process."""
        del device
        self._network = Network(self._model)

    def decode_request(self, request: Annotated[bytes, Body()]) -> bytes:
        """The windows as they came."""
        return request

    def predict(self, windows: bytes) -> bytes:
        """The counts."""
        return self._network.predict(windows)

    def encode_response(self, counts: bytes) -> Response:
        """The counts as they are."""
        return Response(counts, media_type="application/octet-stream")


def main() -> None:
    """Serve until terminated."""
    arguments = server_arguments()
    server = litserve.LitServer(NetworkApi(arguments.model), accelerator="cpu", timeout=False)
    server.run(host=arguments.address, port=arguments.port, generate_client_file=False, log_level="warning")


if __name__ == "__main__":
    main()

"""Ray Serve with one replica: raw bytes in, raw bytes out."""

import signal

import ray  # type: ignore[import-not-found]
from ray import serve
from starlette.requests import Request  # type: ignore[import-not-found]
from starlette.responses import Response  # type: ignore[import-not-found]

from .network import Network, server_arguments


class NetworkReplica:
    """The network in Ray's worker process."""

    def __init__(self, model: str) -> None:
        self._network = Network(model)

    async def __call__(self, request: Request) -> Response:
        """Answer one request."""
        counts = self._network.predict(await request.body())
        return Response(counts, media_type="application/octet-stream")


def main() -> None:
    """Serve until terminated."""
    arguments = server_arguments()
    ray.init(num_cpus=2, include_dashboard=False, configure_logging=False)
    serve.start(http_options={"host": arguments.address, "port": arguments.port})
    replica = serve.deployment(max_ongoing_requests=128)(NetworkReplica)
    serve.run(replica.bind(arguments.model), route_prefix="/predict")
    signal.sigwait([signal.SIGTERM, signal.SIGINT])
    ray.shutdown()


if __name__ == "__main__":
    main()

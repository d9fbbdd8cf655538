"""FastAPI under uvicorn, with uvloop and httptools: raw bytes in, raw bytes out, one process."""

import uvicorn  # type: ignore[import-not-found]
from fastapi import FastAPI, Request, Response  # type: ignore[import-not-found]

from .network import Network, server_arguments


def main() -> None:
    """Serve until terminated."""
    arguments = server_arguments()
    network = Network(arguments.model)
    app = FastAPI()

    async def predict(request: Request) -> Response:
        counts = network.predict(await request.body())
        return Response(counts, media_type="application/octet-stream")

    app.post("/predict")(predict)
    uvicorn.run(
        app,
        host=arguments.address,
        port=arguments.port,
        log_level="warning",
        loop="uvloop",
        http="httptools",
    )


if __name__ == "__main__":
    main()

"""gRPC on its asyncio server: raw bytes in, raw bytes out, without protobuf messages."""

import asyncio

import grpc  # type: ignore[import-untyped]

from .network import Network, server_arguments

SERVICE = "taxel.Network"
METHOD = "Predict"


async def serve(model: str, endpoint: str) -> None:
    """Serve until terminated."""
    network = Network(model)

    async def predict(body: bytes, context: grpc.aio.ServicerContext) -> bytes:
        del context
        return network.predict(body)

    methods = {METHOD: grpc.unary_unary_rpc_method_handler(predict)}
    server = grpc.aio.server()
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, methods),))
    server.add_insecure_port(endpoint)
    await server.start()
    await server.wait_for_termination()


def main() -> None:
    """Serve until terminated."""
    arguments = server_arguments()
    asyncio.run(serve(arguments.model, f"{arguments.address}:{arguments.port}"))


if __name__ == "__main__":
    main()

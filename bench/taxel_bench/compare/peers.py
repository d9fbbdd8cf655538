"""The peers: what each needs installed, and which programs are its server and its client."""

from dataclasses import dataclass
from typing import Final

from taxel_bench.environments import own_versions
from taxel_bench.options import parse_names


@dataclass(frozen=True)
class PeerServer:
    """A way to serve a network that a user may pick instead of Taxel.

    Attributes:
        name: on the command line.
        packages: pinned; what they need follows from them.
        server: module of `peer_programs`, run under the peer's interpreter.
        client: module of `peer_programs`.
        client_needs_packages: whether the client runs under the peer's interpreter, too.
    """

    name: str
    packages: tuple[str, ...]
    server: str
    client: str = "http_client"
    client_needs_packages: bool = False

    @property
    def requirements(self) -> tuple[str, ...]:
        """The packages, with the ONNX Runtime and NumPy that Taxel itself runs on."""
        return (*self.packages, *own_versions("onnxruntime", "numpy"))


PEERS: Final = (
    PeerServer(
        "fastapi",
        ("fastapi==0.165.0", "uvicorn==0.54.0", "uvloop==0.23.0", "httptools==0.9.0"),
        server="fastapi_server",
    ),
    PeerServer("litserve", ("litserve==0.2.19",), server="litserve_server"),
    PeerServer("ray", ("ray[serve]==2.60.0",), server="ray_server"),
    PeerServer("mosec", ("mosec==0.9.8",), server="mosec_server"),
    PeerServer(
        "grpc", ("grpcio==1.85.1",), server="grpc_server", client="grpc_client", client_needs_packages=True
    ),
)


def parse_peers(text: str) -> list[PeerServer]:
    """Peers from `fastapi,grpc`, in the order given.

    Raises:
        SettingsError: there is no such peer.
    """
    known = {peer.name: peer for peer in PEERS}
    return [known[name] for name in parse_names("--peers", text, known, "peer")]

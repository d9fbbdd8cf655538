"""The server's options: their names, defaults, limits and help texts, in one place."""

from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, Field, field_validator, model_validator

from taxel.endpoints import EXPECTED, is_loopback
from taxel.lane.offer import parse_address
from taxel.protocol import MAX_ROWS, PREFIX

Rows = Annotated[int, Field(gt=0, le=2**24)]

Admin = Literal["loopback", "any", "off"]
"""From where an operator's orders are taken."""

RIGHTS: Final = ("infer", "metadata", "administration")
"""What a client may be allowed: to predict; to read what a server tells; to load and unload models."""

_WITH_TLS: Final = ("tls/", "quic/")


class ServerOptions(BaseModel):
    """How a server runs."""

    repository: Path | None = Field(
        default=None,
        description="Folder of artifacts to serve, as NAME/VERSION/; if none, Taxel's own.",
    )
    listen: tuple[str, ...] = Field(
        default=("tcp/127.0.0.1:7447",),
        min_length=1,
        description="Endpoint to listen on, as tcp/HOST:PORT; may be given several times.",
    )
    tls_certificate: Path | None = Field(
        default=None, description="PEM file of the server's certificate, for endpoints tls/HOST:PORT."
    )
    tls_key: Path | None = Field(default=None, description="PEM file of that certificate's private key.")
    tls_client_ca: Path | None = Field(
        default=None,
        description="PEM file of the authority whose certificates clients must have: mutual TLS.",
    )
    users: Path | None = Field(
        default=None,
        description="File with a line USER:PASSWORD for each user; others do not get in over zenoh.",
    )
    allow: tuple[str, ...] = Field(
        default=(),
        description="What a user, or a certificate's common name, may do, as NAME=RIGHT+RIGHT of infer, "
        "metadata and administration; may be given several times. If none, all who get in may infer and "
        "read metadata; --admin says who may load and unload.",
    )
    prefix: str = Field(
        default=PREFIX,
        pattern=r"^[A-Za-z0-9._-]+(/[A-Za-z0-9._-]+)*$",
        description="First part of every key that the server answers.",
    )
    max_batch_rows: Rows = Field(default=1024, description="The most windows in one evaluation.")
    max_request_rows: Rows = Field(default=MAX_ROWS, description="The most windows in one request.")
    max_queue_rows: Rows = Field(
        default=131_072, description="The most windows that wait, over all requests."
    )
    max_queue_requests: int = Field(
        default=2048,
        gt=0,
        le=2**20,
        description="The most requests that wait; each is answered before the server stops.",
    )
    max_queue_mib: int = Field(
        default=64,
        gt=0,
        le=2**16,
        description="The most MiB of the requests that wait; the largest request always fits.",
    )
    max_queue_seconds: float = Field(
        default=4.0,
        gt=0,
        le=3600,
        description="The most seconds of evaluation that wait, as far as the server knows its models.",
    )
    threads: int = Field(default=1, gt=0, le=256, description="The most threads of one evaluation.")
    providers: tuple[str, ...] = Field(
        default=("CPUExecutionProvider",),
        min_length=1,
        description="ONNX Runtime's execution provider, best first; may be given several times.",
    )
    shared_memory: bool = Field(
        default=False,
        description="Whether local clients may use shared memory for large requests. The memory of such a "
        "client is held until the server ends.",
    )
    lane: str = Field(
        default="auto",
        description="Where clients on this machine may ask without zenoh: auto, unix:PATH, "
        "tcp:127.0.0.1:PORT or off. auto is a file in the user's runtime folder.",
    )
    spin_us: int = Field(
        default=0,
        ge=0,
        le=100_000,
        description="Microseconds that the lane asks for the next request before it sleeps. Takes a core.",
    )
    halt: bool = Field(
        default=True,
        description="Whether idle cores may sleep deeply; --no-halt needs the right to write "
        "/dev/cpu_dma_latency, and costs power.",
    )
    http: str = Field(
        default="off",
        description="Where metrics and health are told over HTTP, as HOST:PORT, or off.",
    )
    websocket: str = Field(
        default="off",
        description="Where web pages of this machine may ask over a WebSocket, as 127.0.0.1:PORT, or off.",
    )
    websocket_origins: tuple[str, ...] = Field(
        default=(),
        description="Where a page that may ask comes from, as https://HOST; may be given several times. "
        "Pages from loopback always may.",
    )
    watchable: bool = Field(
        default=False,
        description="Whether any client may watch what all clients ask and get (taxel watch).",
    )
    load_seconds: int = Field(
        default=20,
        gt=0,
        le=3600,
        description="Seconds of the processor that a version may take, in the process that loads it.",
    )
    load_memory_mib: int = Field(
        default=4096, ge=64, le=2**24, description="MiB that a version may take for it."
    )
    watch_seconds: float = Field(
        default=1.0,
        ge=0,
        le=86_400,
        description="Seconds between two looks for new versions in the repository; 0 for none.",
    )
    admin: Admin = Field(
        default="loopback",
        description="Who may load and unload versions, if --allow names nobody: clients over loopback or a "
        "unix socket, any client, or nobody (off).",
    )
    drain_seconds: float = Field(
        default=1.2,
        ge=0,
        le=3600,
        description="Seconds to finish the queued requests after a signal to stop.",
    )

    @field_validator("listen", "providers", "allow", "websocket_origins", mode="before")
    @classmethod
    def _several(cls, value: Any) -> Any:
        """An environment variable may name several, separated by commas."""
        return [part.strip() for part in value.split(",")] if isinstance(value, str) else value

    @field_validator("listen")
    @classmethod
    def _can_be_told(cls, endpoints: tuple[str, ...]) -> tuple[str, ...]:
        for endpoint in endpoints:
            protocol, slash, address = endpoint.partition("/")
            if not (protocol and slash and address):
                raise ValueError(f"{endpoint!r}: {EXPECTED}")
            if address.endswith(":0"):
                raise ValueError(f"{endpoint!r}: expected a port that clients can be told, not 0")
        return endpoints

    @field_validator("lane")
    @classmethod
    def _is_local(cls, lane: str) -> str:
        if lane not in ("auto", "off"):
            parse_address(lane)
        return lane

    @field_validator("http")
    @classmethod
    def _is_address(cls, http: str) -> str:
        if http != "off":
            host_and_port(http)
        return http

    @field_validator("websocket")
    @classmethod
    def _is_of_loopback(cls, websocket: str) -> str:
        if websocket != "off" and not is_loopback(host_and_port(websocket)[0]):
            raise ValueError(f"{websocket!r}: expected a port of loopback, such as 127.0.0.1:7449, or off")
        return websocket

    @field_validator("allow")
    @classmethod
    def _names_rights(cls, allowed: tuple[str, ...]) -> tuple[str, ...]:
        for each in allowed:
            name, _, rights = each.partition("=")
            if not name or not set(rights.split("+")) <= set(RIGHTS):
                raise ValueError(f"{each!r}: expected NAME=RIGHT+RIGHT with rights of {', '.join(RIGHTS)}")
        if len({each.partition("=")[0] for each in allowed}) < len(allowed):
            raise ValueError("a name is given twice: expected all its rights together, as NAME=RIGHT+RIGHT")
        return allowed

    def rights(self) -> dict[str, tuple[str, ...]]:
        """What each name of `allow` may do."""
        split = (each.partition("=") for each in self.allow)
        return {name: tuple(rights.split("+")) for name, _, rights in split}

    @model_validator(mode="after")
    def _keeps_its_promise(self) -> Self:
        """No option that keeps clients out may be without effect."""
        with_tls = [endpoint.startswith(_WITH_TLS) for endpoint in self.listen]
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("tls_certificate, tls_key: expected both or neither")
        if any(with_tls) != (self.tls_certificate is not None):
            raise ValueError("listen: expected tls/HOST:PORT with tls_certificate and tls_key, or neither")
        if self.tls_client_ca is not None and not all(with_tls):
            raise ValueError("tls_client_ca: expected tls/HOST:PORT only, as others show no certificate")
        if self.allow and self.users is None and self.tls_client_ca is None:
            raise ValueError("allow: expected users or tls_client_ca, which tell who a client is")
        if (self.users or self.tls_client_ca) and self.lane.startswith("tcp:"):
            raise ValueError(
                f"lane {self.lane}: any user of the machine may ask there: expected unix:PATH or off"
            )
        if (self.users or self.tls_client_ca) and self.websocket != "off":
            raise ValueError(
                f"websocket {self.websocket}: any user of the machine may ask there: expected off"
            )
        if self.websocket != "off" and self.lane == "off":
            raise ValueError(f"websocket {self.websocket}: expected a lane, which it passes requests to")
        return self

    @model_validator(mode="after")
    def _fit_each_other(self) -> Self:
        if self.max_request_rows > self.max_queue_rows:
            raise ValueError(
                f"max_request_rows {self.max_request_rows}: expected at most max_queue_rows, "
                f"{self.max_queue_rows}, or the largest requests could never be queued"
            )
        return self


def host_and_port(address: str) -> tuple[str, int]:
    """The host and the port of `HOST:PORT`.

    Raises:
        ValueError: it is none.
    """
    host, colon, port = address.rpartition(":")
    if not (colon and host and port.isascii() and port.isdigit() and int(port) < 65_536):
        raise ValueError(f"{address!r}: expected HOST:PORT, such as 127.0.0.1:9464, or off")
    return host.strip("[]"), int(port)

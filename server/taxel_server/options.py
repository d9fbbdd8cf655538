"""The server's options: their names, defaults, limits and help texts, in one place."""

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, Field, field_validator, model_validator

from taxel.endpoints import EXPECTED
from taxel.lane.offer import parse_address
from taxel.protocol import MAX_ROWS, PREFIX

Rows = Annotated[int, Field(gt=0, le=2**24)]


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
    load_seconds: int = Field(
        default=20,
        gt=0,
        le=3600,
        description="Seconds of the processor that an ONNX file may take for its first evaluations.",
    )
    load_memory_mib: int = Field(
        default=4096, ge=64, le=2**24, description="MiB that an ONNX file may take for them."
    )
    drain_seconds: float = Field(
        default=1.2,
        ge=0,
        le=3600,
        description="Seconds to finish the queued requests after a signal to stop.",
    )

    @field_validator("listen", "providers", mode="before")
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

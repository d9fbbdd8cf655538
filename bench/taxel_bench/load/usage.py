"""What a server has done and used between two moments: its own counters, and its processor time."""

import re
from dataclasses import dataclass
from typing import Any, Self

import psutil

from taxel.errors import Unavailable
from taxel.manifest import Manifest
from taxel.protocol import model_key, unpackb
from taxel.remote import RemoteSource


@dataclass(frozen=True)
class ServerUsage:
    """A server's counters for one model, and its processor time, at one moment.

    Attributes:
        requests: that were for the model, answered or not.
        batches: that were evaluated.
        batch_rows: the sum of their rows.
        batch_buckets: batches by rows, in buckets that double, named by their upper end.
        cpu_s: processor time of the server's process; None where it is not on this machine.
    """

    requests: int
    batches: int
    batch_rows: int
    batch_buckets: dict[str, int]
    cpu_s: float | None

    @classmethod
    def now(cls, source: RemoteSource, manifest: Manifest) -> Self:
        """Ask the server.

        Raises:
            Unavailable: it does not answer any more.
        """
        cpu_s = cpu_seconds(source.endpoint)
        try:
            answer = source.get(model_key(source.prefix, manifest.name, manifest.version, "stats"))
        except Unavailable:
            raise Unavailable(f"{source.endpoint}: the server has stopped answering") from None
        counters: dict[str, Any] = unpackb(answer)
        batches = counters["batch_rows"]
        return cls(counters["requests"], batches["count"], batches["sum"], batches["buckets"], cpu_s)

    def since(self, before: Self) -> Self:
        """What came after an earlier moment."""
        buckets = {
            end: more
            for end, count in self.batch_buckets.items()
            if (more := count - before.batch_buckets.get(end, 0))
        }
        cpu_s = None
        if self.cpu_s is not None and before.cpu_s is not None:
            cpu_s = self.cpu_s - before.cpu_s
        return type(self)(
            self.requests - before.requests,
            self.batches - before.batches,
            self.batch_rows - before.batch_rows,
            buckets,
            cpu_s,
        )


def cpu_seconds(endpoint: str) -> float | None:
    """Processor time of the process that listens at an endpoint, if it is one of this machine's."""
    process = listening_process(endpoint)
    if process is None:
        return None
    times = process.cpu_times()
    return float(times.user + times.system)


def listening_process(endpoint: str) -> psutil.Process | None:
    """The process that listens at an endpoint; None if it is not here, or may not be looked at."""
    address = re.split("[?#]", endpoint.partition("/")[2])[0]
    host, _, port = address.rpartition(":")
    ours = {place.address for places in psutil.net_if_addrs().values() for place in places} | {"localhost"}
    if host.strip("[]") not in ours:
        return None
    try:
        listening = psutil.net_connections(kind="tcp")
    except psutil.AccessDenied:
        # Some systems tell only root which process listens where.
        return None
    for connection in listening:
        if connection.status == psutil.CONN_LISTEN and connection.laddr.port == int(port):
            return psutil.Process(connection.pid) if connection.pid else None
    return None

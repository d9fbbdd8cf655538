"""One run: clients get ready, the server's counters are read, queries are sent, counters are read again."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import taxel
from taxel.manifest import Manifest
from taxel_bench.load.clients import ready_clients
from taxel_bench.load.records import Records
from taxel_bench.load.settings import LoadSettings
from taxel_bench.load.usage import ServerUsage
from taxel_bench.server_process import running_server


@dataclass(frozen=True)
class Outcome:
    """What a run gave.

    Attributes:
        manifest: of the model that answered.
        records: of the queries of all clients.
        server: what the server did and used during the run.
        clients_cpu_s: processor time of all clients during the run.
    """

    manifest: Manifest
    records: Records
    server: ServerUsage
    clients_cpu_s: float


@contextmanager
def server_at(endpoint: str | None, repository: Path, *arguments: str) -> Iterator[str]:
    """The endpoint of a running server; without one, of a server started for as long as the block lasts.

    Args:
        endpoint: of the running server.
        repository: what a server that is started serves.
        arguments: further ones of its command.

    Raises:
        Unavailable: the server stopped before it was ready.
    """
    if endpoint is not None:
        yield endpoint
        return
    with running_server(repository, *arguments) as started:
        yield started


def drive(settings: LoadSettings, endpoint: str) -> Outcome:
    """Send the settings' queries to the server at an endpoint.

    Raises:
        Unavailable: nobody listens there, or the server stopped answering.
        NotFound: it has no such model.
    """
    with taxel.connect(endpoint, timeout=settings.timeout_s) as source:
        manifest = source.predictor(settings.model).manifest
        with ready_clients(settings, endpoint) as clients:
            before = ServerUsage.now(source, manifest)
            finished = clients.run()
            server = ServerUsage.now(source, manifest).since(before)
    return Outcome(
        manifest=manifest,
        records=np.concatenate([report.records for report in finished]),
        server=server,
        clients_cpu_s=sum(report.cpu_s for report in finished),
    )

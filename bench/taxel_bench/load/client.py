"""A client process: connects, gets ready, waits for the start, sends its queries, reports."""

import gc
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Final

from taxel.errors import TaxelError
from taxel.remote import RemoteSource, Transport
from taxel_bench.load.records import Records
from taxel_bench.load.settings import LoadSettings
from taxel_bench.load.streams import Stream

WARM_UP: Final = 10
"""Queries of each client before the run that do not count."""


@dataclass(frozen=True)
class Ready:
    """Said by a client that waits for the start."""


@dataclass(frozen=True)
class Finished:
    """Said by a client at its end.

    Attributes:
        records: of its queries.
        cpu_s: processor time of the run, all threads.
    """

    records: Records
    cpu_s: float


def work(pipe: Connection, endpoint: str, settings: LoadSettings, client: int) -> None:
    """What a client process runs.

    Says `Ready` into the pipe, is told the start on the clock `time.perf_counter`, which is the same
    in all processes of a machine, and says `Finished`; or a `TaxelError` instead of either.
    """
    try:
        _converse(pipe, endpoint, settings, client)
    except TaxelError as error:
        pipe.send(error)
    except (EOFError, BrokenPipeError):
        # Nobody is left to report to: the process that started this one has gone.
        return


def _converse(pipe: Connection, endpoint: str, settings: LoadSettings, client: int) -> None:
    transport: Transport = "lane" if settings.server == "taxel-lane" else "zenoh"
    with RemoteSource(endpoint, timeout=settings.timeout_s, transport=transport) as source:
        stream = Stream.of(source, settings, client)
        stream.warm_up(WARM_UP)
        pipe.send(Ready())
        start = pipe.recv()
        # A collection would hold up whatever is due meanwhile; the run makes no cycles.
        gc.collect()
        gc.disable()
        before = time.process_time()
        records = stream.run(start)
        pipe.send(Finished(records, time.process_time() - before))

"""The queries of one client that are on their way, and the records of those that are back."""

import time
from functools import partial
from threading import Semaphore

import numpy as np

from taxel.errors import DeadlineExceeded, RequestError, Unavailable
from taxel.remote.query_transport import Done
from taxel_bench.load.records import RECORD, Records, record


class QueriesInFlight:
    """Up to so many queries, of which any number may be in flight.

    Args:
        queries: how many there will be at most.
        samples: windows in each.
        start: what times count from, on the clock `time.perf_counter`.
    """

    def __init__(self, queries: int, samples: int, start: float) -> None:
        self._samples = samples
        self._start = start
        self._sent = 0
        self._back = Semaphore(0)
        self._records = np.zeros(queries, RECORD)
        # A query that never comes back stays as it is here.
        self._records["code"] = DeadlineExceeded.code
        self.server_gone = False
        """Whether no server answered a query."""

    def depart(self, scheduled: float) -> Done:
        """Note that the next query is sent now; what to call with its answer."""
        number, sent = self._sent, time.perf_counter() - self._start
        self._sent += 1
        self._records["scheduled"][number], self._records["sent"][number] = scheduled, sent
        return partial(self._arrive, number, scheduled, sent)

    def _arrive(self, number: int, scheduled: float, sent: float, result: bytes | RequestError) -> None:
        answered = time.perf_counter() - self._start
        self._records[number] = record(scheduled, sent, answered, result, self._samples)
        if isinstance(result, Unavailable):
            self.server_gone = True
        self._back.release()

    def land(self, patience_s: float) -> Records:
        """The records of all that were sent, once all are back or the time is over."""
        ends = time.perf_counter() + patience_s
        for _ in range(self._sent):
            if not self._back.acquire(timeout=max(0.0, ends - time.perf_counter())):
                break
        return self._records[: self._sent].copy()

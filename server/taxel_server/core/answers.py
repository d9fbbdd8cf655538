"""Gives the answers of the batcher. They are counted by model, and errors are taken note of."""

import logging
from collections import defaultdict, deque
from collections.abc import Iterable, Set
from threading import Lock
from typing import Any, Final

from taxel.errors import Cancelled, RequestError
from taxel.protocol import InferResponse
from taxel.trace_context import trace_id_of
from taxel_server.core.jobs import Job
from taxel_server.core.refusals import Refusals
from taxel_server.core.spans import Spans
from taxel_server.core.statistics import ModelStatistics
from taxel_server.engine import LoadedModel

_LOG: Final = logging.getLogger(__name__)

_MOST_UNCOUNTED: Final = 256
"""Requests whose statistics wait to be counted together: this takes less time for each."""


class Answers:
    """Gives and counts answers. Thread-safe.

    Args:
        refusals: takes note of the jobs that get an error here.
    """

    def __init__(self, refusals: Refusals) -> None:
        self._refusals = refusals
        self._spans = Spans.available()
        self._lock = Lock()
        self._statistics: defaultdict[LoadedModel, ModelStatistics] = defaultdict(ModelStatistics)
        self._alone: deque[tuple[LoadedModel, int, int]] = deque()
        """Evaluated at once and not counted yet: model, rows, time in µs."""

    def give(self, job: Job, result: InferResponse | RequestError) -> None:
        """Count an answer and give it; the job must not be open any more."""
        with self._lock:
            if isinstance(result, Cancelled):
                self._statistics[job.model].add_cancelled(job.left)
            elif isinstance(result, RequestError):
                self._statistics[job.model].add_error(result.code)
            else:
                self._statistics[job.model].add_response(result)
        if isinstance(result, RequestError) and not isinstance(result, Cancelled):
            self._refusals.add(
                result,
                client=job.caller,
                model=job.model.label,
                request_id=job.request_id,
                trace_id=trace_id_of(job.traceparent),
            )
        tell(job, result)
        if job.traceparent is not None and self._spans is not None:
            self._spans.add(job, job.traceparent, result)

    def give_all(self, jobs: Iterable[Job], error: RequestError) -> None:
        """Give the same error to many."""
        for job in jobs:
            self.give(job, error)

    def count_alone(self, model: LoadedModel, rows: int, compute_us: int) -> None:
        """Count a request that was evaluated at once, a little later."""
        self._alone.append((model, rows, compute_us))
        if len(self._alone) >= _MOST_UNCOUNTED:
            with self._lock:
                self._count_waiting()

    def count_error(self, model: LoadedModel, code: str) -> None:
        """Count a request whose error somebody else gives."""
        with self._lock:
            self._statistics[model].add_error(code)

    def count_batch(self, model: LoadedModel, rows: int) -> None:
        """Count one evaluation."""
        with self._lock:
            self._statistics[model].add_batch(rows)

    @property
    def given(self) -> int:
        """Answers and errors since the start."""
        with self._lock:
            self._count_waiting()
            return sum(statistics.requests for statistics in self._statistics.values())

    def of(self, model: LoadedModel) -> dict[str, Any]:
        """The statistics of a model."""
        with self._lock:
            self._count_waiting()
            return self._statistics[model].as_dict()

    def succeed(self, old: LoadedModel, new: LoadedModel) -> None:
        """Count the requests of a version that was loaded again together with those from before."""
        with self._lock:
            self._count_waiting()
            self._statistics[new] = self._statistics[old]

    def keep(self, models: Set[LoadedModel]) -> None:
        """Forget all other models."""
        with self._lock:
            self._count_waiting()
            for model in self._statistics.keys() - models:
                del self._statistics[model]

    def _count_waiting(self) -> None:
        """Count what was evaluated at once; call it under the lock."""
        while self._alone:
            model, rows, compute_us = self._alone.popleft()
            self._statistics[model].add_alone(rows, compute_us)


def tell(job: Job, result: InferResponse | RequestError) -> None:
    """Give an answer that is counted already."""
    # The two refer to each other: their numbers would stay until the next garbage collection.
    job.work = None
    try:
        job.answer(result)
        if job.seen is not None:
            job.seen(job, result)
    except Exception:
        # Whoever answers must survive a caller that has gone.
        _LOG.exception("%s: an answer could not be given", job.model.label, extra=job.log_fields)

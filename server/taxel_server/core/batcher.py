"""Greedy batching: take one request, add the queued ones, evaluate. It knows no transport.

No request waits for a batch to fill: requests gather while the batch before is computed. A request larger
than a batch is evaluated one batch at a time and goes back behind the others each time. So it does not
block the others, and deadlines and stopping reach it.
"""

import logging
import time
from collections import defaultdict
from collections.abc import Sequence
from math import inf
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import DeadlineExceeded, Internal, RequestError, ResourceExhausted, Unavailable
from taxel.protocol import InferResponse
from taxel_server.core.jobs import Job, Work, checked_request, response_of
from taxel_server.core.refusals import Refusals
from taxel_server.core.statistics import ModelStatistics
from taxel_server.engine import LoadedModel

_LOG: Final = logging.getLogger(__name__)

Piece = tuple[Work, int]
"""A request and how many of its windows a batch takes."""


class Batcher:
    """Answers every job exactly once, in a worker thread, or at once if it is idle.

    Args:
        max_batch_rows: most windows evaluated in one go.
        max_queue_rows: most windows submitted and not yet answered.
        max_queue_requests: most jobs submitted and not yet answered.
        refusals: takes note of the jobs that get an error here.
    """

    def __init__(
        self,
        *,
        max_batch_rows: int,
        max_queue_rows: int,
        max_queue_requests: int,
        refusals: Refusals | None = None,
    ) -> None:
        self._refusals = refusals or Refusals()
        self._max_batch_rows = max_batch_rows
        self._max_queue_rows = max_queue_rows
        self._max_queue_requests = max_queue_requests
        self._queue: SimpleQueue[Job | Work | None] = SimpleQueue()
        self._lock = Lock()
        self._rows = 0
        self._open: set[Job] = set()
        """Submitted and not yet answered."""
        self._stopping = False
        self._draining = False
        self._give_up_at = inf
        self._statistics: defaultdict[LoadedModel, ModelStatistics] = defaultdict(ModelStatistics)
        self._worker = Thread(target=self._run, name="taxel-batcher", daemon=True)

    def start(self) -> None:
        """Start the worker."""
        self._worker.start()

    def submit(self, job: Job) -> None:
        """Queue a job; returns at once.

        Raises:
            ResourceExhausted: the queue is full; the job is not answered here.
            Unavailable: the batcher was closed; the job is not answered here.
        """
        with self._lock:
            self._enter(job)
            self._queue.put(job)

    def run(self, job: Job) -> None:
        """Like `submit`, but if the batcher is idle, a single window is answered before this returns.

        Waking the worker would take as long as evaluating a window.
        """
        with self._lock:
            busy = bool(self._open)
            self._enter(job)
            if busy or job.rows > 1:
                self._queue.put(job)
                return
        try:
            response = self._answer_at_once(job)
        except Exception:
            # The way of a batch takes longer, and knows what to say of each failure.
            if (work := self._admit(job)) is not None:
                self._evaluate(job.model, [(work, work.left)])
        else:
            self._settle(job, response, batch_rows=1)

    def _answer_at_once(self, job: Job) -> InferResponse:
        """The answer to a single window, without a batch."""
        request = checked_request(job)
        started = time.monotonic()
        timeout_ms = inf if request.timeout_ms is None else request.timeout_ms
        if started >= self._give_up_at or (started - job.arrived) * 1e3 > timeout_ms:
            raise DeadlineExceeded
        outputs = job.model.evaluate(request.windows)
        if outputs.shape != (1, job.model.columns):
            raise ValueError
        return response_of(job, request, outputs, started, time.monotonic() - started, 1)

    def _enter(self, job: Job) -> None:
        """Accept a job, if there is room; call it under the lock."""
        if self._stopping:
            raise Unavailable("the server is stopping")
        if self._rows + job.rows > self._max_queue_rows or len(self._open) + 1 > self._max_queue_requests:
            error = ResourceExhausted(
                f"the queue is full: {self._rows} of {self._max_queue_rows} rows, "
                f"{len(self._open)} of {self._max_queue_requests} requests; try again later"
            )
            self._statistics[job.model].add_error(error.code)
            raise error
        self._open.add(job)
        self._rows += job.rows

    @property
    def queued_rows(self) -> int:
        """Windows submitted and not yet answered."""
        return self._rows

    @property
    def open_requests(self) -> int:
        """Jobs submitted and not yet answered."""
        return len(self._open)

    @property
    def is_alive(self) -> bool:
        """Whether the worker runs."""
        return self._worker.is_alive()

    @property
    def answered(self) -> int:
        """Jobs that got an answer or a refusal since the start; it rises as long as there is progress."""
        return sum(statistics.requests for statistics in [*self._statistics.values()])

    def statistics(self, model: LoadedModel) -> dict[str, Any]:
        """The statistics of a model."""
        with self._lock:
            return self._statistics[model].as_dict()

    def stop(self, drain_seconds: float) -> None:
        """Take no more jobs; returns at once.

        Jobs that are not finished in time are answered with `Unavailable`, as soon as the current
        evaluation ends.
        """
        with self._lock:
            self._give_up_at = min(self._give_up_at, time.monotonic() + drain_seconds)
            if not self._stopping:
                self._stopping = True
                self._queue.put(None)

    def abandon(self) -> None:
        """Answer every open job with `Unavailable` at once."""
        with self._lock:
            jobs = list(self._open)
        for job in jobs:
            self._settle(job, Unavailable("the server is stopping"))

    def join(self) -> None:
        """Return when every queued job has its answer, after `stop`."""
        self._worker.join()

    def _run(self) -> None:
        while (batch := self._next_batch()) is not None:
            for model, pieces in batch.items():
                self._evaluate(model, pieces)

    def _next_batch(self) -> dict[LoadedModel, list[Piece]] | None:
        """The queued requests, up to one batch. Waits for the first; None when closed and done."""
        batch: dict[LoadedModel, list[Piece]] = defaultdict(list)
        room = self._max_batch_rows
        while room:
            try:
                item = self._queue.get(block=not batch and not self._draining)
            except Empty:
                break
            if item is None:
                self._draining = True
            elif (work := self._admit(item)) is not None:
                rows = min(room, work.left)
                batch[work.job.model].append((work, rows))
                room -= rows
        return None if self._draining and not batch else batch

    def _admit(self, item: Job | Work) -> Work | None:
        """The checked request. None if it was refused, or is too late; then it has its answer."""
        job = item.job if isinstance(item, Work) else item
        try:
            now = time.monotonic()
            if now >= self._give_up_at:
                raise Unavailable("the server is stopping")
            work = item if isinstance(item, Work) else Work(item)
            work.check_deadline(now)
        except RequestError as error:
            self._settle(job, error)
        except Exception:
            _LOG.exception("%s: a request could not be decoded", job.model.label)
            self._settle(job, Internal("the request could not be decoded: the server's log says more"))
        else:
            return work
        return None

    def _evaluate(self, model: LoadedModel, pieces: Sequence[Piece]) -> None:
        """Evaluate pieces together. If that fails, evaluate each alone: only the faulty one fails."""
        windows = [work.next_windows(rows) for work, rows in pieces]
        joined = windows[0] if len(windows) == 1 else np.concatenate(windows)
        started = time.monotonic()
        try:
            outputs = model.evaluate(joined)
            if outputs.shape != (len(joined), model.columns):
                raise ValueError(f"predicted {outputs.shape} for {joined.shape}")
        except Exception:
            if len(pieces) > 1:
                for piece in pieces:
                    self._evaluate(model, [piece])
                return
            _LOG.exception("%s: evaluation failed", model.label)
            self._settle(pieces[0][0].job, Internal(f"{model.label} failed: the server's log says more"))
            return
        ended = time.monotonic()
        with self._lock:
            self._statistics[model].add_batch(len(joined))
        self._hand_out(pieces, outputs, started, ended)

    def _hand_out(
        self, pieces: Sequence[Piece], outputs: NDArray[np.float32], started: float, ended: float
    ) -> None:
        first = 0
        for work, rows in pieces:
            part = outputs[first : first + rows]
            work.keep(part, started=started, ended=ended, batch_rows=len(outputs))
            first += rows
            if work.left:
                self._queue.put(work)
            else:
                self._settle(work.job, work.response())

    def _settle(self, job: Job, result: InferResponse | RequestError, batch_rows: int = 0) -> None:
        """Answer a job and remove it from the open jobs, unless `abandon` has done so.

        Args:
            job: to answer.
            result: its answer.
            batch_rows: of an evaluation that was not counted yet.
        """
        with self._lock:
            if job not in self._open:
                return
            self._open.remove(job)
            self._rows -= job.rows
            if batch_rows:
                self._statistics[job.model].add_batch(batch_rows)
            if isinstance(result, RequestError):
                self._statistics[job.model].add_error(result.code)
            else:
                self._statistics[job.model].add_response(result)
        if isinstance(result, RequestError):
            self._refusals.add(result, client=job.client, model=job.model.label, request_id=job.request_id)
        try:
            job.answer(result)
        except Exception:
            # The worker must survive a caller that has gone.
            _LOG.exception("%s: an answer could not be given", job.model.label)

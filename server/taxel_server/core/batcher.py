"""Greedy batching: take one request, add the queued ones, evaluate. It knows no transport.

No request waits for a batch to fill: requests gather while the batch before is computed. A request larger
than a batch is evaluated one batch at a time and goes back behind the others each time. So it does not
block the others, and deadlines and stopping reach it.
"""

import logging
import time
from collections import defaultdict, deque
from collections.abc import Sequence
from math import inf
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import Internal, RequestError, ResourceExhausted, Unavailable
from taxel.protocol import InferResponse
from taxel.windows.checks import check_finite
from taxel_server.core.jobs import Job, Work
from taxel_server.core.refusals import Refusals
from taxel_server.core.statistics import ModelStatistics
from taxel_server.engine import LoadedModel

_LOG: Final = logging.getLogger(__name__)

_CHANNELS: Final = len(CHANNELS)

_AT_ONCE_ROWS: Final = 16
"""The most windows that are evaluated by the thread that receives them, if nothing else is open."""

_MOST_UNCOUNTED: Final = 256
"""Requests whose statistics wait to be counted together: this takes less time for each."""

Piece = tuple[Work, int]
"""A request and how many of its windows a batch takes."""


class AtOnce(NamedTuple):
    """A request that was evaluated at once: counts (n, 21) float32, and how long it took."""

    counts: NDArray[np.float32]
    compute_us: int


class Batcher:
    """Answers every job exactly once, in a worker thread; evaluates a small request at once if it is idle.

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
        self._alone: deque[tuple[LoadedModel, int, int]] = deque()
        """Evaluated at once and not counted yet: model, rows, time in µs."""
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
        """Like `submit`, but a single window is answered before this returns if nothing else is open."""
        if not self._answered_at_once(job):
            self.submit(job)

    def _answered_at_once(self, job: Job) -> bool:
        if job.rows > 1:
            return False
        try:
            request = job.decode()
        except Exception:
            return False  # The way of a batch knows what to say of each failure.
        waited_ms = (time.monotonic() - job.arrived) * 1e3
        late = request.timeout_ms is not None and waited_ms > request.timeout_ms
        done = None if late or request.spread else self.evaluate_if_idle(job.model, request.windows)
        if done is None:
            return False
        name, version, counts = job.model.manifest.name, job.model.manifest.version, done.counts
        _give(job, InferResponse(counts, name, version, request.id, 0, done.compute_us, len(counts)))
        return True

    def evaluate_if_idle(self, model: LoadedModel, windows: NDArray[np.float32]) -> AtOnce | None:
        """The counts of a small request, evaluated before this returns; None if something is in the way.

        Then the request must be submitted: it waits for others, or is refused with the right error. Waking
        the worker would take longer than evaluating a window, so nothing is queued, and no lock is held.

        Args:
            model: what is asked.
            windows: (n, c) float32, C-contiguous.
        """
        rows, columns = windows.shape
        if self._open or self._stopping or not 0 < rows <= _AT_ONCE_ROWS or columns != model.features:
            return None
        started = time.monotonic()
        try:
            check_finite(windows, model.manifest.window.features)
            outputs = model.evaluate(windows)
        except Exception:
            return None
        if outputs.shape[1] != _CHANNELS:
            outputs = outputs[:, :_CHANNELS]
        if outputs.shape != (rows, _CHANNELS):
            return None
        compute_us = round((time.monotonic() - started) * 1e6)
        self._alone.append((model, rows, compute_us))
        if len(self._alone) >= _MOST_UNCOUNTED:
            with self._lock:
                self._count_alone()
        return AtOnce(outputs, compute_us)

    def _count_alone(self) -> None:
        """Count what was evaluated at once; call it under the lock."""
        while self._alone:
            model, rows, compute_us = self._alone.popleft()
            self._statistics[model].add_alone(rows, compute_us)

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
        with self._lock:
            self._count_alone()
            return sum(statistics.requests for statistics in self._statistics.values())

    def statistics(self, model: LoadedModel) -> dict[str, Any]:
        """The statistics of a model."""
        with self._lock:
            self._count_alone()
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

    def _settle(self, job: Job, result: InferResponse | RequestError) -> None:
        """Answer a job and remove it from the open jobs, unless `abandon` has done so."""
        with self._lock:
            if job not in self._open:
                return
            self._open.remove(job)
            self._rows -= job.rows
            if isinstance(result, RequestError):
                self._statistics[job.model].add_error(result.code)
            else:
                self._statistics[job.model].add_response(result)
        if isinstance(result, RequestError):
            self._refusals.add(result, client=job.client, model=job.model.label, request_id=job.request_id)
        _give(job, result)


def _give(job: Job, result: InferResponse | RequestError) -> None:
    try:
        job.answer(result)
    except Exception:
        # Whoever answers must survive a caller that has gone.
        _LOG.exception("%s: an answer could not be given", job.model.label)

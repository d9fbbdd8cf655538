"""Evaluates what the policy chooses, and answers. It knows no transport.

No request waits for a batch to fill: requests gather while the slice before is computed. A large request is
evaluated slice by slice, between those of others.
"""

import logging
import time
from collections.abc import Hashable, Iterable, Sequence
from math import inf
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import Cancelled, Internal, RequestError, ResourceExhausted, Unavailable
from taxel.protocol import InferResponse
from taxel.windows.checks import check_values
from taxel_server.core.answers import Answers, tell
from taxel_server.core.jobs import Job, Work, too_late
from taxel_server.core.policy import Policy, Slice, Ticket
from taxel_server.core.refusals import Refusals
from taxel_server.core.run_delay import RunDelay
from taxel_server.core.shadows import Shadows
from taxel_server.core.shares import Amounts
from taxel_server.engine import LoadedModel
from taxel_server.memory import FreeMemory

_LOG: Final = logging.getLogger(__name__)

_STOPPING: Final = "the server is stopping"

_CHANNELS: Final = len(CHANNELS)

_AT_ONCE_ROWS: Final = 16
"""The most windows that are evaluated by the thread that receives them, if nothing else is open."""

Piece = tuple[Work, int]
"""A request and how many of its next windows are evaluated."""


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
        max_queue_bytes: most bytes of their requests.
        max_queue_seconds: most time that their evaluation will probably take.
        refusals: takes note of the jobs that get an error here.
    """

    def __init__(
        self,
        *,
        max_batch_rows: int,
        max_queue_rows: int,
        max_queue_requests: int,
        max_queue_bytes: int,
        max_queue_seconds: float,
        refusals: Refusals | None = None,
    ) -> None:
        self._answers = Answers(refusals or Refusals())
        limits = Amounts(max_queue_requests, max_queue_rows, max_queue_bytes, max_queue_seconds)
        self._policy: Policy[Job] = Policy(limits, max_batch_rows)
        self._lock = Lock()
        self._bell: SimpleQueue[None] = SimpleQueue()
        self._idle = Event()
        """Set while nothing waits, and the worker for the bell."""
        self._memory = FreeMemory()
        self.shadows: Final = Shadows()
        self._stopping = False
        self._give_up_at = inf
        self._worker = Thread(target=self._run, name="taxel-batcher", daemon=True)
        self._run_delay: RunDelay | None = None

    def start(self) -> None:
        """Start the worker."""
        self._worker.start()
        self._run_delay = RunDelay(self._worker)

    def submit(self, job: Job) -> None:
        """Queue a job; returns at once.

        Raises:
            ResourceExhausted: its client has had its share; the job is not answered here.
            Unavailable: the batcher was closed; the job is not answered here.
        """
        with self._lock:
            self._queue(job)

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
        # Spans are made where answers of the queue are given.
        elsewhere = late or request.spread or request.traceparent is not None
        done = None if elsewhere else self.evaluate_if_idle(job.model, request.windows)
        if done is None:
            return False
        name, version, counts = job.model.manifest.name, job.model.manifest.version, done.counts
        tell(job, InferResponse(counts, name, version, request.id, 0, done.compute_us, len(counts)))
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
        if self._policy or self._stopping or not 0 < rows <= _AT_ONCE_ROWS or columns != model.features:
            return None
        started = time.monotonic()
        try:
            check_values(windows, model.manifest.window.features)
            outputs = model.evaluate(windows)
        except Exception:
            return None
        if outputs.shape[1] != _CHANNELS:
            outputs = outputs[:, :_CHANNELS]
        if outputs.shape != (rows, _CHANNELS):
            return None
        compute_us = round((time.monotonic() - started) * 1e6)
        if self.shadows.shadowed:
            self.shadows.offer(model, windows, outputs)
        self._answers.count_alone(model, rows, compute_us)
        return AtOnce(outputs, compute_us)

    def _queue(self, job: Job) -> None:
        """Give a job to the policy, if there is room; call it under the lock."""
        if self._stopping:
            raise Unavailable(_STOPPING)
        self._memory.note(job.size)
        self._refuse(job, self._policy.arrive(job))
        self._wake()

    def check_room(self, ticket: Ticket) -> None:
        """Say whether a request would be accepted now, before its windows are read.

        Raises:
            ResourceExhausted: its client has had its share.
        """
        with self._lock:
            self._refuse(ticket, self._policy.refusal(ticket))

    def wait_until_idle(self, seconds: float) -> bool:
        """Return once nothing waits, or after so many seconds; whether nothing waits."""
        return self._idle.wait(seconds)

    def _refuse(self, ticket: Ticket, refusal: str | None) -> None:
        if refusal is not None:
            self._answers.count_error(ticket.model, ResourceExhausted.code)
            open_requests = self._policy.shares.of(ticket.client).requests
            # A variable that held the error would keep this frame, and so the request, until a collection.
            raise ResourceExhausted(f"{refusal}; try again later", open_requests)

    def _wake(self) -> None:
        if self._idle.is_set():
            self._idle.clear()
            self._bell.put(None)

    @property
    def queued_rows(self) -> int:
        """Windows submitted and not yet answered."""
        return self._policy.shares.taken.rows

    @property
    def open_requests(self) -> int:
        """Jobs submitted and not yet answered."""
        return len(self._policy)

    @property
    def is_alive(self) -> bool:
        """Whether the worker runs."""
        return self._worker.is_alive()

    @property
    def answered(self) -> int:
        """Jobs that got an answer or a refusal since the start; it rises as long as there is progress."""
        return self._answers.given

    def run_delay(self) -> float | None:
        """Seconds that the worker was ready to run and waited for a processor; None if nobody tells."""
        return self._run_delay.seconds() if self._run_delay else None

    def statistics(self, model: LoadedModel) -> dict[str, Any]:
        """The statistics of a model."""
        return self._answers.of(model)

    def succeed(self, old: LoadedModel, new: LoadedModel) -> None:
        """Count the requests of a version that was loaded again together with those from before."""
        self._answers.succeed(old, new)

    def keep(self, models: Iterable[LoadedModel]) -> bool:
        """Forget all other models, which get no more requests; False if some still have open ones."""
        kept = set(models)
        with self._lock:
            busy = {job.model for job in self._policy} - kept
            self._answers.keep(kept | busy)
            self._policy.keep(kept | busy)
            self._memory.note(FreeMemory.MUCH_BYTES)
            self._wake()
        return not busy

    def gone(self, source: Hashable) -> None:
        """Drop the requests of a connection or a session that is no longer there to be answered."""
        with self._lock:
            dropped = self._policy.gone(source)
        self._answers.give_all(dropped, Cancelled("the client has gone"))

    def cancel(self, name: Hashable) -> bool:
        """Drop the request of this name: its client has given it up. False if there is none open."""
        with self._lock:
            dropped = self._policy.cancel(name)
        if dropped is not None:
            self._answers.give(dropped, Cancelled("the client has given it up"))
        return dropped is not None

    def stop(self, drain_seconds: float) -> None:
        """Take no more jobs; returns at once.

        Jobs that are not finished in time are answered with `Unavailable`, as soon as the current
        evaluation ends.
        """
        with self._lock:
            self._give_up_at = min(self._give_up_at, time.monotonic() + drain_seconds)
            self._stopping = True
            self._wake()

    def abandon(self) -> None:
        """Answer every open job with `Unavailable` at once."""
        with self._lock:
            dropped = self._drop_all()
        self._answers.give_all(dropped, Unavailable(_STOPPING))

    def join(self) -> None:
        """Return when every queued job has its answer, after `stop`."""
        self._worker.join()

    def _run(self) -> None:
        # The loop has no variables: they would keep the last model while the worker waits.
        while self._step():
            pass

    def _step(self) -> bool:
        """Evaluate the next slice; False when stopping and nothing is left."""
        chosen = self._next()
        if chosen is None:
            return False
        started = time.monotonic()
        for job in chosen.late:
            self._answers.give(job, too_late(job, started))
        # A request may have a window more than was estimated: its last piece takes what is left.
        pieces = [
            (work, rows if job.left else work.left)
            for job, rows in chosen.pieces
            if (work := job.work or self._decoded(job)) is not None
        ]
        if pieces:
            started = time.monotonic()
            self._evaluate(chosen.model, pieces)
            with self._lock:
                finished = self._policy.done(chosen, time.monotonic() - started)
            for job in finished:
                assert job.work is not None
                self._answers.give(job, job.work.response())
        return True

    def _next(self) -> Slice[Job] | None:
        """What to evaluate next. Waits for it; None when stopping and nothing is left."""
        while True:
            with self._lock:
                now = time.monotonic()
                dropped = self._drop_all() if now >= self._give_up_at else []
                chosen = self._policy.next(now)
                if chosen is None and self._stopping and not dropped:
                    return None
                if chosen is None and not dropped:
                    self._idle.set()
            if chosen is not None:
                return chosen
            if dropped:
                self._answers.give_all(dropped, Unavailable(_STOPPING))
            else:
                self._wait_idle()

    def _wait_idle(self) -> None:
        """Wait for work. If none comes for a while after much work, give memory back to the system."""
        try:
            self._bell.get(timeout=self._memory.idle_s)
        except Empty:
            self._memory.release()

    def _drop_all(self) -> list[Job]:
        return [job for job in self._policy if self._policy.drop(job)]

    def _decoded(self, job: Job) -> Work | None:
        """The checked request. None if it was refused, is too late or given up; then it has its answer."""
        try:
            job.work = work = Work(job)
        except RequestError as error:
            self._settle(job, error)
        except Exception:
            _LOG.exception("%s: a request could not be decoded", job.model.label, extra=job.log_fields)
            self._settle(job, Internal("the request could not be decoded: the server's log says more"))
        else:
            job.deadline = work.deadline
            if (now := time.monotonic()) <= job.deadline:
                with self._lock:
                    if self._policy.shorten(job, work.rows):
                        return work
                job.work = None
                return None
            self._settle(job, too_late(job, now))
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
            job = pieces[0][0].job
            _LOG.exception("%s: evaluation failed", model.label, extra=job.log_fields)
            self._settle(job, Internal(f"{model.label} failed: the server's log says more"))
            return
        ended = time.monotonic()
        self._answers.count_batch(model, len(joined))
        if self.shadows.shadowed:
            self.shadows.offer(model, joined, outputs)
        first = 0
        for (work, _), part in zip(pieces, windows, strict=True):
            kept = outputs[first : first + len(part)]
            work.keep(kept, started=started, ended=ended, batch_rows=len(outputs))
            first += len(part)

    def _settle(self, job: Job, result: InferResponse | RequestError) -> None:
        """Answer a job that is still open, unless `abandon` or `gone` has done so."""
        with self._lock:
            if not self._policy.drop(job):
                return
        self._answers.give(job, result)

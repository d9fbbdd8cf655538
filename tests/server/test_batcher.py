"""The batcher alone: every job is answered once, with its own rows, and no evaluation is too large."""

import gc
import logging
import weakref
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from threading import Event, current_thread

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from taxel.errors import (
    Cancelled,
    DeadlineExceeded,
    Internal,
    InvalidArgument,
    RequestError,
    ResourceExhausted,
    Unavailable,
)
from taxel.protocol import InferRequest, InferResponse
from taxel_server.core.batcher import Batcher
from taxel_server.core.jobs import Job
from taxel_server.engine import Engine, LoadedModel

POISON = 666.0


class Recorder:
    """A runtime whose outputs repeat a window's first value; it fails on poison and can be held."""

    features = 6
    parameters = 0

    def __init__(self) -> None:
        self.batches: list[int] = []
        self.threads: list[str] = []
        self.entered = Event()
        self.may_go_on = Event()
        self.may_go_on.set()

    def evaluate(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        self.entered.set()
        assert self.may_go_on.wait(10)
        self.batches.append(len(windows))
        self.threads.append(current_thread().name)
        if (windows == POISON).any():
            raise ArithmeticError("poison")
        return np.repeat(windows[:, :1], 21, axis=1)


class MemoryJob(Job):
    """A job whose request and answers lie in memory."""

    def __init__(
        self,
        model: LoadedModel,
        windows: NDArray[np.float32],
        timeout_ms: float | None = None,
        client: str = "somebody",
        name: int | None = None,
    ) -> None:
        super().__init__(model, len(windows), windows.nbytes, client, name=name)
        self.request = InferRequest(windows, timeout_ms=timeout_ms)
        self.answers: list[InferResponse | RequestError] = []
        self.answered = Event()

    def decode(self) -> InferRequest:
        return self.request

    def answer(self, result: InferResponse | RequestError) -> None:
        self.answers.append(result)
        self.answered.set()

    def result(self) -> InferResponse | RequestError:
        assert self.answered.wait(10)
        (result,) = self.answers
        return result


class ForgetfulJob(MemoryJob):
    """Keeps no answer: an error would hold the job by its traceback."""

    def answer(self, result: InferResponse | RequestError) -> None:
        self.answered.set()


def windows_of(*values: float) -> NDArray[np.float32]:
    return np.repeat(np.array(values, np.float32)[:, None], 6, axis=1)


def values_of(job: MemoryJob) -> list[float]:
    result = job.result()
    assert isinstance(result, InferResponse), result
    assert result.outputs.shape == (len(job.request.windows), 21)
    return [float(value) for value in result.outputs[:, 20]]


@pytest.fixture
def runtime() -> Recorder:
    return Recorder()


@pytest.fixture
def model(engine: Engine, runtime: Recorder) -> LoadedModel:
    return LoadedModel(engine.model("skin").manifest, runtime)


@contextmanager
def batching(
    max_batch_rows: int = 8,
    max_queue_rows: int = 1000,
    max_queue_requests: int = 1000,
    max_queue_bytes: int = 10**6,
) -> Iterator[Batcher]:
    batcher = Batcher(
        max_batch_rows=max_batch_rows,
        max_queue_rows=max_queue_rows,
        max_queue_requests=max_queue_requests,
        max_queue_bytes=max_queue_bytes,
        max_queue_seconds=60,
    )
    batcher.start()
    try:
        yield batcher
    finally:
        batcher.stop(10)
        batcher.join()


@contextmanager
def busy(batcher: Batcher, model: LoadedModel, runtime: Recorder) -> Iterator[MemoryJob]:
    """Holds the worker in an evaluation, so that whatever is submitted meanwhile queues."""
    runtime.entered.clear()
    runtime.may_go_on.clear()
    job = MemoryJob(model, windows_of(-1))
    batcher.submit(job)
    assert runtime.entered.wait(10)
    try:
        yield job
    finally:
        runtime.may_go_on.set()


def test_idle_means_that_nothing_waits(model: LoadedModel, runtime: Recorder) -> None:
    with batching() as batcher, ThreadPoolExecutor(1) as pool:
        assert batcher.wait_until_idle(3600)
        with busy(batcher, model, runtime) as first:
            assert not batcher.wait_until_idle(0.01)
            waiting = pool.submit(batcher.wait_until_idle, 3600)
            assert not waiting.done()
        assert waiting.result(10)
        assert values_of(first) == [-1]
        assert batcher.wait_until_idle(3600)


def test_no_request_waits_for_the_garbage_collector(
    model: LoadedModel, runtime: Recorder, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)  # A record that is kept holds its error, and so the job.

    def submitted(job: MemoryJob) -> weakref.ref[MemoryJob]:
        with suppress(ResourceExhausted):
            batcher.submit(job)
        return weakref.ref(job)

    gc.disable()
    try:
        with batching(max_queue_rows=8) as batcher:
            with busy(batcher, model, runtime):
                jobs = {
                    "refused": submitted(ForgetfulJob(model, windows_of(*range(9)))),
                    "answered": submitted(ForgetfulJob(model, windows_of(1, 2))),
                    "wrong": submitted(ForgetfulJob(model, windows_of(np.nan))),
                    "late": submitted(ForgetfulJob(model, windows_of(3), timeout_ms=0.001)),
                    "failed": submitted(ForgetfulJob(model, windows_of(POISON))),
                }
            assert batcher.wait_until_idle(10)
            assert [what for what, job in jobs.items() if job() is not None] == []
    finally:
        gc.enable()


@given(st.lists(st.integers(1, 30), min_size=1, max_size=20), st.integers(1, 12))
def test_every_job_gets_its_own_rows_once(engine: Engine, sizes: list[int], max_batch_rows: int) -> None:
    runtime = Recorder()
    model = LoadedModel(engine.model("skin").manifest, runtime)
    starts = np.cumsum([0, *sizes])
    jobs = [
        MemoryJob(model, windows_of(*range(start, start + size)))
        for start, size in zip(starts[:-1], sizes, strict=True)
    ]
    with batching(max_batch_rows) as batcher:
        for job in jobs:
            batcher.submit(job)
        for job in jobs:
            assert values_of(job) == [row[0] for row in job.request.windows]
    assert max(runtime.batches) <= max_batch_rows
    assert sum(runtime.batches) == sum(sizes)


def test_the_estimate_of_rows_may_be_wrong(model: LoadedModel, runtime: Recorder) -> None:
    jobs = []
    with batching() as batcher:
        for told, values in ((1, (1, 2)), (3, (1, 2)), (30, range(28)), (9, range(10)), (8, range(9))):
            job = MemoryJob(model, windows_of(*values))
            job.rows = job.left = told
            jobs.append(job)
            batcher.submit(job)
        for job in jobs:
            assert values_of(job) == [row[0] for row in job.request.windows]
        lone = MemoryJob(model, windows_of(1, 2))
        lone.rows = lone.left = 1
        batcher.run(lone)
        assert values_of(lone) == [1, 2]
        assert batcher.queued_rows == 0


def test_what_queues_meanwhile_is_evaluated_together(model: LoadedModel, runtime: Recorder) -> None:
    with batching() as batcher:
        with busy(batcher, model, runtime):
            jobs = [MemoryJob(model, windows_of(value, value)) for value in range(5)]
            for job in jobs:
                batcher.submit(job)
        assert [values_of(job) for job in jobs] == [[value, value] for value in range(5)]
    assert runtime.batches == [1, 8, 2]


def test_a_single_window_is_answered_on_return_where_nothing_is_to_be_done(
    model: LoadedModel, runtime: Recorder
) -> None:
    here = current_thread().name
    with batching() as batcher:
        for value in (1, 2):
            job = MemoryJob(model, windows_of(value))
            batcher.run(job)
            assert job.answers
            assert values_of(job) == [value]
        small = batcher.evaluate_if_idle(model, windows_of(*range(16)))
        assert small is not None
        np.testing.assert_array_equal(small.counts[:, 20], range(16))
        assert runtime.threads == [here] * 3
        assert batcher.evaluate_if_idle(model, windows_of(*range(17))) is None
        assert batcher.evaluate_if_idle(model, np.zeros((1, 5), np.float32)) is None
        two = MemoryJob(model, windows_of(3, 4))
        batcher.run(two)
        assert values_of(two) == [3, 4]
        with busy(batcher, model, runtime):
            waiting = MemoryJob(model, windows_of(5))
            batcher.run(waiting)
            assert not waiting.answers
            assert batcher.evaluate_if_idle(model, windows_of(6)) is None
        assert values_of(waiting) == [5]
        assert here not in runtime.threads[3:]
        assert batcher.queued_rows == 0
        assert batcher.statistics(model)["rows"] == 1 + 1 + 16 + 2 + 1 + 1


def test_what_is_answered_on_return_is_refused_and_fails_as_any_other(
    model: LoadedModel, runtime: Recorder, caplog: pytest.LogCaptureFixture
) -> None:
    with batching() as batcher:
        for windows, kind in (
            (windows_of(np.nan), InvalidArgument),
            (windows_of(POISON), Internal),
            (np.zeros((1, 5), np.float32), InvalidArgument),
        ):
            job = MemoryJob(model, windows)
            batcher.run(job)
            assert isinstance(job.result(), kind)
        late = MemoryJob(model, windows_of(1), timeout_ms=1)
        late.arrived -= 1
        batcher.run(late)
        assert isinstance(late.result(), DeadlineExceeded)
        assert batcher.statistics(model)["requests"] == 4
        batcher.stop(60)
        with pytest.raises(Unavailable):
            batcher.run(MemoryJob(model, windows_of(1)))
    assert "ArithmeticError: poison" in caplog.text


def test_models_are_not_mixed(engine: Engine, model: LoadedModel, runtime: Recorder) -> None:
    other_runtime = Recorder()
    other = LoadedModel(engine.model("skin", "2").manifest, other_runtime)
    with batching() as batcher:
        with busy(batcher, model, runtime):
            jobs = [MemoryJob((model, other)[value % 2], windows_of(value)) for value in range(6)]
            for job in jobs:
                batcher.submit(job)
        for value, job in enumerate(jobs):
            assert values_of(job) == [value]
            assert job.result().model_version == ("10", "2")[value % 2]
    assert (runtime.batches, other_runtime.batches) == ([1, 3], [3])


def test_a_large_request_lets_small_ones_pass(model: LoadedModel, runtime: Recorder) -> None:
    finished: list[str] = []
    with batching(max_batch_rows=4) as batcher:
        with busy(batcher, model, runtime):
            large, small = MemoryJob(model, windows_of(*range(40))), MemoryJob(model, windows_of(7))
            for name, job in (("large", large), ("small", small)):
                give = job.answer
                job.answer = lambda result, name=name, give=give: (finished.append(name), give(result))
                batcher.submit(job)
        assert values_of(large) == list(range(40))
    assert finished == ["small", "large"]


def test_only_the_guilty_fails(
    model: LoadedModel, runtime: Recorder, caplog: pytest.LogCaptureFixture
) -> None:
    with batching() as batcher:
        with busy(batcher, model, runtime):
            good, bad, fine = (MemoryJob(model, windows_of(value)) for value in (1, POISON, 3))
            for job in (good, bad, fine):
                batcher.submit(job)
        assert (values_of(good), values_of(fine)) == ([1], [3])
        assert isinstance(bad.result(), Internal)
        after = MemoryJob(model, windows_of(4))
        batcher.submit(after)
        assert values_of(after) == [4]
    assert "ArithmeticError: poison" in caplog.text


def test_an_answer_that_cannot_be_given_harms_nobody_else(
    model: LoadedModel, caplog: pytest.LogCaptureFixture
) -> None:
    class Gone(MemoryJob):
        def answer(self, result: InferResponse | RequestError) -> None:
            raise ConnectionError(f"gone before {type(result).__name__}")

    with batching() as batcher:
        batcher.submit(Gone(model, windows_of(1)))
        job = MemoryJob(model, windows_of(2))
        batcher.submit(job)
        assert values_of(job) == [2]
    assert "gone before InferResponse" in caplog.text


@pytest.mark.parametrize(
    ("windows", "text"),
    [
        (np.zeros((2, 5), np.float32), r"inputs\[0\].shape: \[2, 5\]: expected \[n, 6\] for skin/10"),
        (windows_of(1, np.nan), r"window\[1, 'x'\] is nan"),
        (windows_of(np.inf), r"window\[0, 'x'\] is inf"),
    ],
)
def test_wrong_windows_are_refused(
    model: LoadedModel, runtime: Recorder, windows: NDArray[np.float32], text: str
) -> None:
    with batching() as batcher:
        job = MemoryJob(model, windows)
        batcher.submit(job)
        with pytest.raises(InvalidArgument, match=text):
            raise job.result()
    assert runtime.batches == []


def test_an_expired_request_is_not_computed(model: LoadedModel, runtime: Recorder) -> None:
    with batching() as batcher:
        with busy(batcher, model, runtime):
            late = MemoryJob(model, windows_of(1), timeout_ms=1)
            patient = MemoryJob(model, windows_of(2), timeout_ms=1e8)
            late.arrived -= 1
            patient.arrived -= 1
            batcher.submit(late)
            batcher.submit(patient)
        assert isinstance(late.result(), DeadlineExceeded)
        assert values_of(patient) == [2]
    assert sum(runtime.batches) == 2


@pytest.mark.parametrize(
    ("limits", "told"),
    [
        (
            {"max_queue_rows": 8},
            "4 of 8 rows, 4 of them yours; with 1 more you would have more than is left",
        ),
        ({"max_queue_requests": 4}, "2 of 4 requests, 2 of them yours; with 1 more you would have more"),
        ({"max_queue_bytes": 200}, "96 of 200 bytes, 96 of them yours"),
    ],
)
def test_a_full_queue_refuses_and_recovers(
    model: LoadedModel, runtime: Recorder, limits: dict[str, int], told: str
) -> None:
    with batching(**limits) as batcher:
        with busy(batcher, model, runtime) as first:
            queued = MemoryJob(model, windows_of(1, 2, 3))
            batcher.submit(queued)
            assert batcher.queued_rows == 4
            with pytest.raises(ResourceExhausted, match=told):
                batcher.submit(MemoryJob(model, windows_of(9)))
        assert (values_of(first), values_of(queued)) == ([-1], [1, 2, 3])
        again = MemoryJob(model, windows_of(1, 2, 3, 4))
        batcher.submit(again)
        assert values_of(again) == [1, 2, 3, 4]


def test_stopping_finishes_what_is_queued(model: LoadedModel, runtime: Recorder) -> None:
    with batching(max_batch_rows=2) as batcher:
        with busy(batcher, model, runtime):
            jobs = [MemoryJob(model, windows_of(*range(size))) for size in (1, 5, 2)]
            for job in jobs:
                batcher.submit(job)
            batcher.stop(60)
            with pytest.raises(Unavailable):
                batcher.submit(MemoryJob(model, windows_of(1)))
        batcher.join()
        assert [len(job.answers) for job in jobs] == [1, 1, 1]
        assert [values_of(job) for job in jobs] == [[0], [0, 1, 2, 3, 4], [0, 1]]


def test_stopping_gives_up_when_its_time_is_over(model: LoadedModel, runtime: Recorder) -> None:
    jobs = [MemoryJob(model, windows_of(1, 2, 3)) for _ in range(5)]
    with batching(max_batch_rows=2) as batcher:
        with busy(batcher, model, runtime) as running:
            for job in jobs:
                batcher.submit(job)
            batcher.stop(0)
        batcher.join()
        assert values_of(running) == [-1]
        assert all(isinstance(job.result(), Unavailable) for job in jobs)


def test_abandoned_jobs_are_answered_at_once_and_only_once(model: LoadedModel, runtime: Recorder) -> None:
    jobs = [MemoryJob(model, windows_of(1, 2, 3)) for _ in range(5)]
    with batching(max_batch_rows=2) as batcher:
        with busy(batcher, model, runtime) as running:
            for job in jobs:
                batcher.submit(job)
            batcher.stop(60)
            batcher.abandon()
            assert all(isinstance(job.result(), Unavailable) for job in (running, *jobs))
            assert batcher.queued_rows == 0
        batcher.join()
        assert [len(job.answers) for job in (running, *jobs)] == [1] * 6


def test_what_is_given_up_is_not_evaluated(
    model: LoadedModel, runtime: Recorder, caplog: pytest.LogCaptureFixture
) -> None:
    with batching(max_batch_rows=4) as batcher:
        with busy(batcher, model, runtime):
            jobs = [MemoryJob(model, windows_of(value, value), name=value + 1) for value in range(4)]
            for job in jobs:
                batcher.submit(job)
            assert batcher.cancel(2)
            assert not batcher.cancel(2)
            assert not batcher.cancel(99)
            assert isinstance(jobs[1].result(), Cancelled)
            assert batcher.queued_rows == 7
        assert [values_of(jobs[index]) for index in (0, 2, 3)] == [[0, 0], [2, 2], [3, 3]]
        counted = batcher.statistics(model)
    assert counted["cancelled"] == {"requests": 1, "rows": 2}
    assert (counted["requests"], counted["rows"], counted["errors"]) == (5, 7, {})
    assert sum(runtime.batches) == 7
    assert not caplog.records, "to give up is no fault"


def test_a_large_request_that_is_given_up_leaves_in_the_middle(
    model: LoadedModel, runtime: Recorder
) -> None:
    with batching(max_batch_rows=8) as batcher:
        runtime.may_go_on.clear()
        large = MemoryJob(model, windows_of(*range(80)), name=1)
        batcher.submit(large)
        assert runtime.entered.wait(10)
        assert batcher.cancel(1)
        assert isinstance(large.result(), Cancelled)
        runtime.may_go_on.set()
        after = MemoryJob(model, windows_of(5))
        batcher.submit(after)
        assert values_of(after) == [5]
        assert batcher.statistics(model)["cancelled"] == {"requests": 1, "rows": 72}
    assert runtime.batches == [8, 1]
    assert len(large.answers) == 1


def test_what_is_given_up_while_it_is_decoded_is_not_evaluated(
    model: LoadedModel, runtime: Recorder
) -> None:
    with batching(max_batch_rows=8) as batcher:

        class GivenUp(MemoryJob):
            def decode(self) -> InferRequest:
                assert batcher.cancel(self.name)
                return self.request

        given_up = GivenUp(model, windows_of(*range(20)), name=1)
        given_up.rows = given_up.left = 21
        batcher.submit(given_up)
        assert isinstance(given_up.result(), Cancelled)
        after = MemoryJob(model, windows_of(5))
        batcher.submit(after)
        assert values_of(after) == [5]
    assert runtime.batches == [1]


@given(st.lists(st.tuples(st.integers(1, 30), st.booleans()), min_size=1, max_size=20))
def test_every_job_is_answered_or_given_up_once(engine: Engine, asked: list[tuple[int, bool]]) -> None:
    runtime = Recorder()
    model = LoadedModel(engine.model("skin").manifest, runtime)
    with batching(max_batch_rows=12) as batcher:
        jobs = []
        for number, (rows, gives_up) in enumerate(asked):
            jobs.append(MemoryJob(model, windows_of(*range(rows)), name=number))
            batcher.submit(jobs[-1])
            if gives_up:
                # The worker is at it meanwhile: it may be too late, and then the answer comes.
                batcher.cancel(number // 2)
        given_up = 0
        for job in jobs:
            if isinstance(job.result(), Cancelled):
                given_up += 1
            else:
                assert values_of(job) == list(range(len(job.request.windows)))
        batcher.stop(10)
        batcher.join()
        counted = batcher.statistics(model)
        assert batcher.queued_rows == batcher.open_requests == 0
    assert [len(job.answers) for job in jobs] == [1] * len(jobs)
    assert (counted["requests"], counted["cancelled"]["requests"]) == (len(jobs), given_up)
    assert sum(runtime.batches) + counted["cancelled"]["rows"] == sum(rows for rows, _ in asked)


def test_statistics_add_up(model: LoadedModel, runtime: Recorder) -> None:
    with batching() as batcher:
        with busy(batcher, model, runtime):
            jobs = [
                MemoryJob(model, windows)
                for windows in (windows_of(np.nan), windows_of(1), windows_of(2, 3))
            ]
            for job in jobs:
                batcher.submit(job)
        jobs[-1].result()
        last = MemoryJob(model, windows_of(4))
        batcher.submit(last)
        last.result()
        counted = batcher.statistics(model)
    assert (counted["requests"], counted["rows"], counted["errors"]) == (5, 5, {"INVALID_ARGUMENT": 1})
    assert counted["batch_rows"] == {"count": 3, "sum": 5, "max": 3, "buckets": {"1": 2, "4": 1}}
    assert counted["queue_us"]["count"] == counted["compute_us"]["count"] == 4

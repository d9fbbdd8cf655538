"""Rounds in several processes of this machine, or on a Dask cluster."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from taxel_models.recovery.benchmark import RecoveryBenchmark, run_rounds
from taxel_models.recovery.rounds import Round

_PLAYED: list[RecoveryBenchmark] = []
"""The benchmark of a worker process: it is sent once, not with each round."""


def run_rounds_on(
    benchmark: RecoveryBenchmark, rounds: int, jobs: int = 1, scheduler: str | None = None
) -> Iterator[Round]:
    """The rounds in the order of their numbers; where they are played changes nothing in them.

    Args:
        jobs: processes of this machine.
        scheduler: a Dask scheduler's address, such as `tcp://10.0.0.1:8786`, to play there instead.

    Raises:
        Unavailable: no scheduler answers, it has no workers, or one is gone for good.
        SettingsError: a Dask worker runs several tasks at once.
    """
    if scheduler is not None:
        return _on_cluster(benchmark, rounds, scheduler)
    return run_rounds(benchmark, rounds) if jobs == 1 else _in_processes(benchmark, rounds, jobs)


def _in_processes(benchmark: RecoveryBenchmark, rounds: int, jobs: int) -> Iterator[Round]:
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), _begin, (benchmark,))
    try:
        yield from pool.map(_play, range(rounds))
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(benchmark: RecoveryBenchmark) -> None:
    _PLAYED[:] = [benchmark]


def _play(number: int) -> Round:
    return _PLAYED[0].play(number)


def _on_cluster(benchmark: RecoveryBenchmark, rounds: int, address: str) -> Iterator[Round]:
    from taxel_models.training.cluster import connect, result_of

    with connect(address) as client:
        sent = client.scatter(benchmark, broadcast=True)
        futures = [
            client.submit(RecoveryBenchmark.play, sent, number, pure=False) for number in range(rounds)
        ]
        for number, future in enumerate(futures):
            played: Round = result_of(future, f"round {number}")
            yield played

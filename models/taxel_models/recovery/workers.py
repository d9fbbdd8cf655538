"""Rounds in several processes of this machine, or on a Dask cluster."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import TypeVar

from taxel_models.loop.inference.constants import Constants
from taxel_models.recovery.benchmark import RecoveryBenchmark, run_rounds
from taxel_models.recovery.rounds import Round

Part = TypeVar("Part")
Result = TypeVar("Result")

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
    return _on_each(benchmark, RecoveryBenchmark.play, range(rounds), "round", jobs, scheduler)


def run_rounds_with(
    benchmark: RecoveryBenchmark,
    constants: Sequence[Constants],
    rounds: int,
    jobs: int = 1,
    scheduler: str | None = None,
) -> Iterator[list[Round]]:
    """All rounds with one set of constants of the inference after the other, in their order.

    One process plays all rounds of a set: they share the model's reference, which takes longer than many
    rounds. The arguments and errors are those of `run_rounds_on`.
    """
    return _on_each(
        benchmark, partial(_with, rounds=rounds), constants, "set of constants", jobs, scheduler
    )


def _with(benchmark: RecoveryBenchmark, constants: Constants, rounds: int) -> list[Round]:
    return list(run_rounds(benchmark.with_constants(constants), rounds))


def _on_each(
    benchmark: RecoveryBenchmark,
    play: Callable[[RecoveryBenchmark, Part], Result],
    parts: Sequence[Part],
    what: str,
    jobs: int,
    scheduler: str | None,
) -> Iterator[Result]:
    if scheduler is not None:
        return _on_cluster(benchmark, play, parts, what, scheduler)
    if jobs == 1:
        return (play(benchmark, part) for part in parts)
    return _in_processes(benchmark, play, parts, jobs)


def _in_processes(
    benchmark: RecoveryBenchmark,
    play: Callable[[RecoveryBenchmark, Part], Result],
    parts: Sequence[Part],
    jobs: int,
) -> Iterator[Result]:
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), _begin, (benchmark,))
    try:
        yield from pool.map(partial(_play, play), parts)
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(benchmark: RecoveryBenchmark) -> None:
    _PLAYED[:] = [benchmark]


def _play(play: Callable[[RecoveryBenchmark, Part], Result], part: Part) -> Result:
    return play(_PLAYED[0], part)


def _on_cluster(
    benchmark: RecoveryBenchmark,
    play: Callable[[RecoveryBenchmark, Part], Result],
    parts: Sequence[Part],
    what: str,
    address: str,
) -> Iterator[Result]:
    from taxel_models.training.cluster import connect, result_of

    with connect(address) as client:
        sent = client.scatter(benchmark, broadcast=True)
        futures = [client.submit(play, sent, part, pure=False) for part in parts]
        for number, future in enumerate(futures):
            played: Result = result_of(future, f"{what} {number}")
            yield played

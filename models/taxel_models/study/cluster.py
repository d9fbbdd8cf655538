"""Running a study on a Dask cluster: folds and cells are tasks."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from distributed import Client, Future, as_completed

from taxel_models.families.family import Progress
from taxel_models.study.cell import CellResult, compute
from taxel_models.study.fold_data import fold_data
from taxel_models.study.folds import Partition
from taxel_models.study.run import Batch, Runner
from taxel_models.study.study_settings import Protocol
from taxel_models.training.cluster import connect, result_of


def cluster_runner(address: str, patience_s: float = 20.0) -> Runner:
    """A `Runner` that computes on the workers of a scheduler, such as `tcp://10.0.0.1:8786`.

    Args:
        patience_s: how long to wait for the scheduler.

    Raises, when it runs:
        Unavailable: no scheduler answers, it has no workers, or one is gone for good.
        SettingsError: a worker runs several tasks at once.
    """

    def compute_there(
        partitions: Mapping[Protocol, Partition], batches: Sequence[Batch], progress: Progress
    ) -> Iterator[CellResult]:
        if not batches:
            return
        with connect(address, patience_s) as client:
            futures = _submitted(client, partitions, batches)
            progress(0.0, f"{len(futures)} cells on {len(client.nthreads())} workers")
            for number, future in enumerate(as_completed(futures, loop=client.loop), start=1):
                result: CellResult = result_of(future, futures[future])
                yield result
                progress(number, f"finished {futures[future]}")

    return compute_there


def _submitted(
    client: Client, partitions: Mapping[Protocol, Partition], batches: Sequence[Batch]
) -> dict[Future, str]:
    """The futures of all cells, with their names.

    Batches come one after another, so few folds' windows are in memory at a time.
    """
    shared: dict[Protocol, Any] = {
        protocol: client.scatter(partitions[protocol], broadcast=True)
        for protocol in {batch.protocol for batch in batches}
    }
    futures = {}
    for rank, batch in enumerate(batches):
        # The first cell's key identifies data, protocol and fold.
        name = f"fold-{batch.protocol}-{batch.combination}-{batch.fold + 1}-{batch.tasks[0].key[:12]}"
        data = client.submit(
            fold_data, shared[batch.protocol], batch.combination, batch.fold, key=name, priority=-rank
        )
        for task in batch.tasks:
            key = f"cell-{task.cell.name}-{task.key[:12]}"
            future = client.submit(compute, data, task, key=key, priority=-rank)
            futures[future] = task.cell.name
    return futures

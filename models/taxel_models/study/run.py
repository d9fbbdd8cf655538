"""Runs a study: finds finished cells, and computes the missing ones here or on a cluster."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Self

from taxel.manifest import RecordingFingerprint
from taxel_models.families.family import Progress, unseen
from taxel_models.recordings import Recording
from taxel_models.study.cell import CellResult, CellTask, compute
from taxel_models.study.fold_data import fold_data
from taxel_models.study.folds import Partition, choose_grouping, partition
from taxel_models.study.published import is_published_data
from taxel_models.study.reduction import reduce_rows
from taxel_models.study.store import Store
from taxel_models.study.study_settings import Cell, Protocol, StudySettings
from taxel_models.training.split import Grouping


@dataclass(frozen=True)
class Batch:
    """Cells that share the windows of a fold, which are built once."""

    protocol: Protocol
    combination: int
    fold: int
    tasks: tuple[CellTask, ...]


Runner = Callable[[Mapping[Protocol, Partition], Sequence[Batch], Progress], Iterator[CellResult]]
"""Computes batches in any order. Takes partitions, batches, and a function for the progress."""


@dataclass(frozen=True)
class Study:
    """Settings applied to recordings.

    Attributes:
        sources: the recordings as read.
        grouping: what the strict protocol holds out whole.
        rows: number of 10 ms ticks.
        rows_used: number of ticks that are used; fewer at a reduced scale.
        published_data: whether this is the paper's data set, all of it.
        partitions: the folds of each protocol.
    """

    settings: StudySettings
    sources: tuple[RecordingFingerprint, ...]
    grouping: Grouping
    rows: int
    rows_used: int
    published_data: bool
    partitions: Mapping[Protocol, Partition]

    @classmethod
    def of(cls, settings: StudySettings, recordings: Sequence[Recording]) -> Self:
        """Divide the recordings as the settings say.

        Raises:
            SettingsError: the settings are not possible with them.
        """
        ticks = [recording.ticks() for recording in recordings]
        grouping = choose_grouping(ticks, settings.grouping, settings.folds)
        used = reduce_rows(ticks, grouping, settings.rows, settings.seed)
        sources = tuple(
            RecordingFingerprint(
                name=recording.name,
                format=recording.format,
                rows=len(recording),
                sha256=recording.fingerprint,
            )
            for recording in recordings
        )
        return cls(
            settings,
            sources,
            grouping,
            sum(map(len, ticks)),
            sum(map(len, used)),
            settings.rows is None and is_published_data(recordings),
            {
                protocol: partition(protocol, used, grouping, settings.folds, settings.seed)
                for protocol in settings.protocols
            },
        )

    def key(self, cell: Cell) -> str:
        """The hash of everything that a cell's result depends on."""
        return self.settings.key(cell, [source.sha256 for source in self.sources], self.grouping)


def run_study(
    study: Study, store: Store, runner: Runner, jobs: int, progress: Progress = unseen
) -> list[CellResult]:
    """Compute what is not in the store yet, keeping each cell as soon as it is finished.

    Args:
        jobs: cores that one cell may use.

    Returns:
        Every cell's result, in the settings' order.
    """
    results = {cell: store.read(cell, study.key(cell)) for cell in study.settings.cells()}
    missing = [cell for cell, result in results.items() if result is None]
    before = len(results) - len(missing)

    def tell(done: float, note: str) -> None:
        progress((before + done) / len(results), note)

    for result in runner(study.partitions, _batches(study, missing, store, jobs), tell):
        cell = Cell(result.protocol, result.combination, result.fold, result.model)
        store.write(cell, result)
        results[cell] = result
    return [result for result in results.values() if result is not None]


def _batches(study: Study, cells: Sequence[Cell], store: Store, jobs: int) -> list[Batch]:
    def task(cell: Cell) -> CellTask:
        key = study.key(cell)
        chosen = study.settings.hyperparameters[cell.model, cell.combination]
        return CellTask(
            cell,
            key,
            chosen,
            study.settings.seed,
            jobs,
            sweep=study.settings.sweeps(cell),
            checkpoint=store.checkpoint(cell, key),
        )

    grouped = groupby(cells, lambda cell: (cell.protocol, cell.combination, cell.fold))
    return [Batch(*shared, tuple(map(task, group))) for shared, group in grouped]


def compute_here(
    partitions: Mapping[Protocol, Partition], batches: Sequence[Batch], progress: Progress
) -> Iterator[CellResult]:
    """Compute one cell after another in this process; a `Runner`."""
    finished = 0

    def tell(done: float, note: str) -> None:
        progress(finished + done, f"{task.cell.name}: {note}")

    for batch in batches:
        data = fold_data(partitions[batch.protocol], batch.combination, batch.fold)
        for task in batch.tasks:
            yield compute(data, task, tell)
            finished += 1

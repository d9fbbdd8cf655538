"""Bulk prediction on the workers of a Dask scheduler: each opens the model once and predicts parts."""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxel.commands.models import open_source
from taxel.errors import ArtifactError, Unavailable
from taxel.predictor import Predictor
from taxel_models.model import ROWS_A_REQUEST
from taxel_models.training.cluster import connect, result_of


class PredictionTask(NamedTuple):
    """What a worker must know to predict as the caller would.

    Attributes:
        connect: the endpoint of a server; None for a repository.
        repository: a folder that workers see under the same path; None for the models that come with Taxel.
        name: the model's.
        version: of the model.
        sha256: of its model file.
        timeout_s: how long an answer is waited for.
    """

    connect: str | None
    repository: Path | None
    name: str
    version: str
    sha256: str
    timeout_s: float


def predictions_of_workers(
    scheduler: str, task: PredictionTask, windows: NDArray[np.float32], patience_s: float = 20.0
) -> Iterator[NDArray[np.float32]]:
    """The counts (m, 21) of parts of the windows (n, f), in their order.

    Args:
        scheduler: its address, such as `tcp://10.0.0.1:8786`.
        patience_s: how long to wait for it.

    Raises:
        Unavailable: no scheduler answers, it has no workers, or one is gone for good.
        SettingsError: a worker runs several tasks at once.
        NotFound: a worker does not find the model.
        ArtifactError: a worker finds another model of that name and version.
    """
    starts = range(0, len(windows), ROWS_A_REQUEST)
    with connect(scheduler, patience_s) as client:
        # Not by content: two parts with the same windows are still two tasks.
        futures = client.map(
            _predict_part,
            [windows[start : start + ROWS_A_REQUEST] for start in starts],
            task=task,
            pure=False,
        )
        for start, future in zip(starts, futures, strict=True):
            counts: NDArray[np.float32] = result_of(future, f"windows from {start}")
            yield counts


def _predict_part(windows: NDArray[np.float32], task: PredictionTask) -> NDArray[np.float32]:
    """What a worker runs."""
    return _predictor(task).predict(windows, timeout=task.timeout_s)


@lru_cache(maxsize=1)
def _predictor(task: PredictionTask) -> Predictor:
    """The task's predictor; a worker keeps the last one."""
    if task.connect is None and task.repository is not None and not task.repository.is_dir():
        raise Unavailable(
            f"a worker does not see the folder {task.repository}: expected it under the same path there"
        )
    predictor = open_source(task.connect, task.repository).predictor(task.name, task.version)
    found = predictor.manifest.model_file.sha256
    if found != task.sha256:
        raise ArtifactError(
            f"{task.name}/{task.version}: a worker has a model file with sha256 {found}: "
            f"expected {task.sha256}, as here"
        )
    return predictor

"""`taxel predict --scheduler` on a real Dask cluster gives what `taxel predict` gives."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster

from taxel.errors import ArtifactError, Unavailable
from taxel_bench.server_process import running_server
from taxel_models.commands import predict_on_cluster
from taxel_models.commands.predict import predict
from taxel_models.commands.predict_on_cluster import PredictionTask, predictions_of_workers
from taxel_models.recordings import write_ruppel
from taxel_models.shipped import shipped_repository
from taxel_models.twin import simulate


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    with LocalCluster(2, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "twin.csv"
    write_ruppel(simulate(10_000, 1), path)
    return path


@pytest.fixture(scope="module")
def alone(recording: Path) -> bytes:
    """What is written without a cluster."""
    place = recording.with_name("alone.csv")
    predict(recording, "xgb", place, as_json=True)
    return place.read_bytes()


def test_workers_write_the_same_file(
    scheduler: str, recording: Path, alone: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(predict_on_cluster, "ROWS_A_REQUEST", 1500)
    place = tmp_path / "there.csv"
    predict(recording, "xgb", place, scheduler=scheduler, as_json=True)
    assert place.read_bytes() == alone
    predict(recording, "xgb", place, repository=shipped_repository(), scheduler=scheduler, as_json=True)
    assert place.read_bytes() == alone


def test_workers_ask_a_server(scheduler: str, recording: Path, alone: bytes, tmp_path: Path) -> None:
    place = tmp_path / "there.csv"
    with running_server(shipped_repository()) as endpoint:
        predict(recording, "xgb/1", place, connect=endpoint, scheduler=scheduler, as_json=True)
    assert place.read_bytes() == alone


def test_another_model_on_a_worker_is_refused(scheduler: str) -> None:
    windows = np.zeros((1, 12), np.float32)
    task = PredictionTask(None, None, "xgb", "1", "0" * 64, 5.0)
    with pytest.raises(ArtifactError, match="a worker has a model file with sha256"):
        list(predictions_of_workers(scheduler, task, windows))
    away = task._replace(repository=Path("/nowhere"))
    with pytest.raises(Unavailable, match="a worker does not see the folder"):
        list(predictions_of_workers(scheduler, away, windows))


def test_a_scheduler_that_is_not_there_is_told() -> None:
    task = PredictionTask(None, None, "xgb", "1", "", 5.0)
    with pytest.raises(Unavailable, match="no Dask scheduler answers"):
        list(predictions_of_workers("tcp://127.0.0.1:9", task, np.zeros((1, 12), np.float32), 0.5))

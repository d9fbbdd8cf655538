"""The same study on a real Dask cluster of two worker processes."""

from pathlib import Path

import pytest
from distributed import LocalCluster

from taxel.errors import SettingsError, Unavailable
from taxel_models.recordings import Recording
from taxel_models.study.cluster import cluster_runner
from taxel_models.study.run import Study, compute_here, run_study
from taxel_models.study.store import Store
from taxel_models.study.study_settings import StudySettings


@pytest.fixture
def study(twin: Recording) -> Study:
    """Trees alone, so that workers need not load torch."""
    overrides = {"xgb": {"n_estimators": 3, "max_depth": 3}}
    return Study.of(StudySettings(("xgb",), (1, 8), folds=3, overrides=overrides), [twin])


@pytest.mark.long
def test_two_workers_find_what_one_process_finds(study: Study, tmp_path: Path) -> None:
    told: list[float] = []
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        there = run_study(
            study,
            Store(tmp_path / "there"),
            cluster_runner(cluster.scheduler_address),
            1,
            lambda done, _: told.append(done),
        )
    here = run_study(study, Store(tmp_path / "here"), compute_here, 1)
    assert [result.model_dump(exclude={"seconds"}) for result in there] == [
        result.model_dump(exclude={"seconds"}) for result in here
    ]
    assert len(list((tmp_path / "there" / "cells").iterdir())) == len(there) == 6
    assert (told[0], told[-1]) == (0, 1)


def test_a_worker_with_several_tasks_is_refused(study: Study, tmp_path: Path) -> None:
    with (
        LocalCluster(1, threads_per_worker=2, processes=False, dashboard_address=":0") as shared,
        pytest.raises(SettingsError, match="2 tasks at once"),
    ):
        run_study(study, Store(tmp_path / "out"), cluster_runner(shared.scheduler_address), 1)


def test_a_scheduler_that_is_not_there_is_told(study: Study, tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match=r"tcp://127\.0\.0\.1:9"):
        run_study(study, Store(tmp_path / "out"), cluster_runner("tcp://127.0.0.1:9", 0.5), 1)

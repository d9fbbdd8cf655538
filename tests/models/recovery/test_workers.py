"""Where rounds are played changes nothing in them."""

import pytest
from distributed import LocalCluster

from taxel.errors import Unavailable
from taxel_models.ground.twins import StoredModel, TwinGround
from taxel_models.loop.inference.constants import DECLARED
from taxel_models.recovery.benchmark import RecoveryBenchmark
from taxel_models.recovery.injected import Draw
from taxel_models.recovery.rounds import Round
from taxel_models.recovery.workers import run_rounds_on, run_rounds_with
from taxel_models.shipped import shipped_repository
from taxel_models.training.cluster import connect, result_of

ROUNDS = 2


@pytest.fixture(scope="module")
def benchmark() -> RecoveryBenchmark:
    ground = TwinGround(StoredModel(shipped_repository(), "network-b"), 1, rows=5000)
    draw = Draw("foreign", ("offset", "gain"), clean_share=0.0, unknown_share=0.0)
    return RecoveryBenchmark(ground, "twin", 1, draw)


@pytest.fixture(scope="module")
def here(benchmark: RecoveryBenchmark) -> list[Round]:
    return list(run_rounds_on(benchmark, ROUNDS))


@pytest.mark.long
def test_processes_play_the_same_rounds_each_with_its_constants(
    benchmark: RecoveryBenchmark, here: list[Round]
) -> None:
    assert [one.number for one in here] == [0, 1]
    assert all(one.injector == "foreign" for one in here)
    strict = DECLARED.moved("chance", 1e-200)
    same, other = run_rounds_with(benchmark, [DECLARED, strict], ROUNDS, jobs=2)
    assert same == here
    assert [one.named for one in other] == [(), ()] != [one.named for one in here]


def test_a_round_whose_worker_is_gone_is_told() -> None:
    with (
        LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster,
        connect(cluster.scheduler_address) as client,
    ):
        future = client.submit(abs, -1)
        future.cancel()
        with pytest.raises(Unavailable, match="round 7: its worker or the scheduler is gone"):
            result_of(future, "round 7")


def test_a_cluster_plays_the_same_rounds(benchmark: RecoveryBenchmark, here: list[Round]) -> None:
    with LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster:
        assert list(run_rounds_on(benchmark, 1, scheduler=cluster.scheduler_address)) == here[:1]

"""`bench chaos`: what is judged, and how."""

import shutil
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

import taxel
from taxel.errors import InvalidArgument, RequestError, ResourceExhausted
from taxel.lane.frames import pack_request_head
from taxel.protocol import model_key, pack_infer_request
from taxel_bench.chaos.arrivals import Refused, noting_server
from taxel_bench.chaos.flood import bars_of, bars_of_floods
from taxel_bench.chaos.flooders import FLOODERS, sender
from taxel_bench.chaos.hostile import (
    bars_of_full_disk,
    bars_of_misbehaviour,
    bars_of_mutated,
    full_disk_of,
    misbehaviour_of,
    mutated_of,
)
from taxel_bench.chaos.misbehaviour import FULL_DISK
from taxel_bench.chaos.mutated import owed_replies
from taxel_bench.chaos.mutations import mutations
from taxel_bench.chaos.senders import Asked, Sent
from taxel_bench.chaos.stopped import bars_of_stopped
from taxel_bench.server_process import RunningServer, running_server_process
from taxel_bench.windows import random_windows
from taxel_models.shipped import shipped_repository

FLOOD: dict[str, Any] = {
    "flooder": "taxel",
    "rows": 64,
    "capacity_per_s": 100.0,
    "answered_per_s": 80.0,
    "refusal_after_sending_ms": {"p50": 1.0, "p99": 5.1, "max": 9.0},
    "waited_for_core": 0.05,
    "polite": {"errors": {"RESOURCE_EXHAUSTED": 1}},
    "calm_mib": 100.0,
    "after_mib": 109.0,
    "monotonic_s": [10.0, 20.0],
}


def test_each_figure_of_a_flood_is_judged_by_its_bar() -> None:
    assert [bar.holds for bar in bars_of(FLOOD)] == [True, False, False, True]
    kind = {
        "answered_per_s": 79.0,
        "refusal_after_sending_ms": None,
        "polite": {"errors": {}},
        "after_mib": 111.0,
    }
    assert [bar.holds for bar in bars_of(FLOOD | kind)] == [False, True, True, False]
    _, refusals, *_ = bars_of(FLOOD | {"waited_for_core": 0.06})
    assert refusals.as_dict()["verdict"] == "no core: it waited 6% of the time"
    assert refusals.holds


def test_the_longest_wait_and_each_failure_beside_stopped_clients_are_judged() -> None:
    quick, slow = {"longest_ms": 8.0, "failed": 0}, {"longest_ms": 500.1, "failed": 1}
    for others, holds in (([quick, quick], [True, True]), ([quick, slow], [False, False])):
        bars = bars_of_stopped({"stopped": 4, "bystanders": others})
        assert [bar.holds for bar in bars] == holds
        assert bars[0].figure == others[1]["longest_ms"]


def test_a_refusal_counts_from_when_its_request_had_been_sent() -> None:
    sent, late = Sent(), Asked(0.0)
    late.sent = time.perf_counter() - 0.002
    for asked in (late, Asked(0.0)):
        sent.add(asked, float("inf"), ResourceExhausted("the queue is full"))
    after, before = sent.refusal_after_sending_ms
    assert after >= 2
    assert before == 0
    assert min(sent.refusal_ms) > after


def test_only_refusals_count_as_refusals_and_only_answers_in_time_as_answers() -> None:
    sent = Sent()
    sent.add(Asked(0.0), float("inf"), b"counts")
    sent.add(Asked(0.0), 0.0, b"counts, too late")
    sent.add(Asked(0.0), float("inf"), ResourceExhausted("the queue is full"))
    assert (sent.answered, len(sent.latency_ms), len(sent.refusal_ms)) == (1, 2, 1)
    assert sent.errors == Counter({"RESOURCE_EXHAUSTED": 1})


def test_refusals_count_from_their_arrival_where_a_server_notes_it() -> None:
    _, sent, *_ = bars_of_floods([dict(FLOOD)])
    assert (sent.what, sent.figure) == ("taxel, 64 windows a request: refusals, p99 ms from sending", 5.1)
    _, arrived, *_ = bars_of_floods([dict(FLOOD)], [(9.9, 50.0), (15.0, 2.0), (20.1, 60.0)])
    assert arrived.what == "taxel, 64 windows a request: refusals, p99 ms from arrival"
    assert arrived.figure == 2.0


def test_a_server_that_notes_refusals_answers_and_refuses_as_the_released_one(tmp_path: Path) -> None:
    shutil.copytree(shipped_repository() / "xgb", tmp_path / "xgb")
    results: SimpleQueue[bytes | RequestError] = SimpleQueue()
    refused: list[Refused] = []
    with noting_server(tmp_path, refused) as endpoint:
        began = time.monotonic()
        with taxel.connect(endpoint, transport="zenoh", timeout=30) as source:
            predictor = source.predictor("xgb")
            windows = random_windows(predictor.manifest, 4096, seed=5)
            payload = pack_infer_request(windows)
            with sender("zenoh", source, model_key(source.prefix, "xgb", None, "infer")) as send:
                for _ in range(200):
                    send(payload, results.put)
                answers = [results.get(timeout=30) for _ in range(200)]
        ended = time.monotonic()
    kinds = Counter(type(each) for each in answers)
    assert kinds.keys() == {bytes, ResourceExhausted}
    assert len(refused) == kinds[ResourceExhausted]
    assert all(began <= at <= ended and 0 <= ms <= (ended - began) * 1e3 for at, ms in refused)


@given(count=st.integers(1, 50), seed=st.integers(0, 1000))
def test_mutations_follow_from_the_seed(count: int, seed: int) -> None:
    valid = bytes(range(100))
    several = list(mutations(valid, count, seed))
    assert several == list(mutations(valid, count, seed))
    assert len(several) == count


def test_what_a_stream_of_frames_is_owed() -> None:
    right = pack_request_head("v2/models/m/infer", 5, (1, 2), 0, spread=False) + bytes(8)
    owed = owed_replies(right + right)
    assert owed is not None
    assert (owed.ids, owed.ends, owed.stream) == (Counter({5: 2}), False, right + right)
    # What is missing at the end of a frame comes from the one behind it, and zeros.
    cut = owed_replies(right[:-4] + right)
    assert cut is not None
    assert cut.ends
    assert cut.ids == Counter({5: 1, 0: 1})
    short = owed_replies(right[:-4])
    assert short is not None
    assert short.stream == right[:-4] + bytes(4)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    repository = tmp_path_factory.mktemp("repository")
    shutil.copytree(shipped_repository() / "xgb", repository / "xgb")
    with running_server_process(repository) as running:
        yield running


def test_mutated_requests_are_answered_once_and_harm_nobody(server: RunningServer) -> None:
    result = mutated_of(server.endpoint, "xgb", 300, seed=1)
    assert [bar for bar in bars_of_mutated(result) if not bar.holds] == []
    for transport in ("zenoh", "lane"):
        told = result[transport]
        assert told["predictions"] > 0
        assert told["errors"]["INVALID_ARGUMENT"] > 0
    assert all(each["answers"] > 0 for each in result["bystanders"])


def test_bad_clients_harm_nobody(server: RunningServer) -> None:
    result = misbehaviour_of(server.endpoint, "xgb", psutil.Process(server.pid))
    assert [bar for bar in bars_of_misbehaviour(result) if not bar.holds] == []
    assert result["unread_requests"] > 0


@pytest.mark.skipif(not FULL_DISK.exists(), reason="this system has no /dev/full")
def test_a_server_whose_log_cannot_be_written_serves_on(tmp_path: Path) -> None:
    shutil.copytree(shipped_repository() / "xgb", tmp_path / "xgb")
    result = full_disk_of(tmp_path, "xgb", seed=2)
    assert [bar for bar in bars_of_full_disk(result) if not bar.holds] == []
    assert sum(result["errors"].values()) > 0


@pytest.mark.parametrize("flooder", FLOODERS)
def test_both_kinds_of_flooders_get_answers_and_typed_errors(server: RunningServer, flooder: str) -> None:
    results: SimpleQueue[bytes | RequestError] = SimpleQueue()
    with taxel.connect(server.endpoint, transport="zenoh") as source:
        manifest = source.predictor("xgb").manifest
        right = pack_infer_request(random_windows(manifest, 1, seed=3))
        with sender(flooder, source, model_key(source.prefix, "xgb", None, "infer")) as send:
            for payload in (right, right[:-4]):
                send(payload, results.put)
            first, second = results.get(timeout=10), results.get(timeout=10)
    kinds = {type(each) for each in (first, second)}
    assert kinds == {bytes, InvalidArgument}

"""The figures and the verdict of runs whose records are known."""

from typing import Any

import numpy as np
import pytest

from taxel import artifacts
from taxel_bench.load.drive import Outcome
from taxel_bench.load.records import RECORD, Records
from taxel_bench.load.results import Results
from taxel_bench.load.settings import LoadSettings, Scenario
from taxel_bench.load.usage import ServerUsage
from taxel_models.shipped import shipped_repository

MANIFEST = artifacts.read(artifacts.folder_of(shipped_repository(), "xgb")).manifest


def records_of(queries: int, code: str = "") -> Records:
    """Due every 10 ms, sent at once, answered after 1 ms, 2 ms …, half of it in the queue."""
    records = np.zeros(queries, RECORD)
    records["scheduled"] = records["sent"] = np.arange(queries) * 0.01
    latency = np.arange(1, queries + 1) / 1e3
    records["answered"] = records["scheduled"] + latency
    records["queue_us"] = latency / 2 * 1e6
    records["compute_us"] = 100
    records["code"] = code
    return records


def results_of(
    records: Records, scenario: Scenario = "server", requests: int | None = None, **options: Any
) -> Results:
    settings = LoadSettings.of(scenario, "xgb", **options)
    asked = len(records) if requests is None else requests
    server = ServerUsage(asked, 2, len(records), {"1": 1, "4": 1}, 0.5)
    return Results.of(settings, Outcome(MANIFEST, records, server, clients_cpu_s=0.25))


def test_a_valid_run_has_its_figures() -> None:
    found = results_of(records_of(1000))
    assert (found.verdict, found.reasons) == ("VALID", [])
    assert (found.sent, found.answered, found.errors) == (1000, 1000, {})
    assert found.seconds == pytest.approx(9.99 + 1.0)
    assert found.queries_per_s == found.samples_per_s == pytest.approx(1000 / 10.99)
    assert found.latency_ms["p50"] == pytest.approx(500.5)
    assert found.latency_ms["p99"] == pytest.approx(990.01)
    assert found.latency_ms["max"] == pytest.approx(1000)
    assert found.queue_ms["p50"] == pytest.approx(250.25)
    assert found.compute_ms["p90"] == pytest.approx(0.1)
    assert found.late_ms is not None
    assert found.late_ms["max"] == 0
    assert (found.server_cpu_us, found.clients_cpu_us) == (500, 250)
    assert sum(found.batch_rows.values()) == found.batches["count"] == 2


def test_a_client_that_waits_before_sending_hides_nothing() -> None:
    """Coordinated omission: sent 5 ms late and answered at once is a latency of 5 ms."""
    records = records_of(1000)
    records["sent"] = records["scheduled"] + 5e-3
    records["answered"] = records["sent"]
    found = results_of(records)
    assert found.latency_ms["p50"] == pytest.approx(5)
    assert found.verdict == "INVALID"
    assert found.reasons == [
        "100.0% of the queries were sent more than 1 ms late: expected at most 1%; "
        "the clients could not keep their schedule"
    ]


@pytest.mark.parametrize(("late", "valid"), [(10, "VALID"), (11, "INVALID")])
def test_one_in_a_hundred_may_be_late(late: int, valid: str) -> None:
    records = records_of(1000)
    records["sent"][:late] += 2e-3
    assert results_of(records).verdict == valid


def test_percentiles_without_support_are_not_told() -> None:
    found = results_of(records_of(100))
    assert [name for name, value in found.latency_ms.items() if value is not None] == ["p50", "p90", "max"]
    assert found.verdict == "INVALID"
    assert found.reasons == ["100 queries do not support p99: at least 662 are needed"]
    assert results_of(records_of(100), "single-stream").verdict == "VALID"


def test_errors_are_counted_by_code_and_left_out_of_the_latencies() -> None:
    records = np.concatenate([records_of(700), records_of(3, "UNAVAILABLE"), records_of(2, "INTERNAL")])
    found = results_of(records)
    assert found.errors == {"INTERNAL": 2, "UNAVAILABLE": 3}
    assert found.sent == found.answered + sum(found.errors.values()) == 705
    assert found.latency_ms["max"] == pytest.approx(700)
    assert found.reasons == ["5 of 705 queries were not answered: 2 INTERNAL, 3 UNAVAILABLE"]


def test_nothing_answered_gives_no_figures() -> None:
    found = results_of(records_of(3, "DEADLINE_EXCEEDED"), "multi-stream")
    assert set(found.latency_ms.values()) == {None}
    assert found.queries_per_s == 0
    assert len(found.reasons) == 2


def test_queries_of_others_are_noticed() -> None:
    found = results_of(records_of(1000), requests=1007)
    assert found.reasons == [
        "the server was asked 1007 times where 1000 queries were sent: others used xgb during the run"
    ]


@pytest.mark.parametrize(("bound", "reasons"), [(991.0, 0), (990.0, 1)])
def test_a_latency_bound_holds_for_the_scenarios_percentile(bound: float, reasons: int) -> None:
    assert len(results_of(records_of(1000), latency_bound_ms=bound).reasons) == reasons


@pytest.mark.parametrize(("queries", "valid"), [(24, "VALID"), (23, "INVALID")])
def test_offline_is_judged_by_its_samples(queries: int, valid: str) -> None:
    found = results_of(records_of(queries), "offline")
    assert found.verdict == valid
    assert found.samples_per_s == pytest.approx(1024 * found.queries_per_s)
    assert found.late_ms is None

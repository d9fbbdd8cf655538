from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxel.errors import SettingsError
from taxel_bench.load.settings import LoadSettings, Scenario


@pytest.mark.parametrize(
    ("scenario", "samples", "queries", "duration_s", "rate_qps"),
    [
        ("single-stream", 1, None, 10.0, None),
        ("multi-stream", 8, None, 10.0, None),
        ("server", 1, 5000, 10.0, 500.0),
        ("offline", 1024, 96, None, None),
    ],
)
def test_each_scenario_has_its_own_defaults(
    scenario: Scenario,
    samples: int,
    queries: int | None,
    duration_s: float | None,
    rate_qps: float | None,
) -> None:
    settings = LoadSettings.of(scenario, "xgb")
    found = (settings.samples_per_query, settings.queries, settings.duration_s, settings.rate_qps)
    assert found == (samples, queries, duration_s, rate_qps)


@pytest.mark.parametrize(
    ("scenario", "options", "text"),
    [
        ("single-stream", {"samples_per_query": 2}, "single-stream sends 1"),
        ("single-stream", {"rate_qps": 5.0}, "--rate 5: only the server scenario"),
        ("server", {"queries": 5, "duration_s": 2.0}, "expected one of the two"),
        ("offline", {"duration_s": 2.0}, "offline sends all at once"),
        ("offline", {"latency_bound_ms": 2.0}, "judged by throughput"),
        ("server", {"queries": 2, "clients": 3}, "--clients 3: more than the 2 queries"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    scenario: Scenario, options: dict[str, Any], text: str
) -> None:
    with pytest.raises(SettingsError, match=text):
        LoadSettings.of(scenario, "xgb", **options)


@given(clients=st.integers(1, 20), more=st.integers(0, 100))
def test_clients_share_all_queries(clients: int, more: int) -> None:
    settings = LoadSettings.of("single-stream", "xgb", clients=clients, queries=clients + more)
    shares = [settings.share(client) or 0 for client in range(clients)]
    assert sum(shares) == clients + more
    assert max(shares) - min(shares) <= 1

"""The queueing simulation beside closed forms, and what must hold of any queue."""

from math import exp, factorial, floor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxel.errors import SettingsError
from taxel_bench.capacity.service_time import ServiceTime
from taxel_bench.scale.plan import Fleet, plan
from taxel_bench.scale.queueing import fleet_sojourn_times, sojourn_times


def waiting_share(wait: float, load: float) -> float:
    """P(W <= wait) of M/D/1, with a service of 1: Erlang's formula (1909)."""
    terms = (
        (load * (done - wait)) ** done / factorial(done) * exp(-load * (done - wait))
        for done in range(floor(wait) + 1)
    )
    return (1 - load) * sum(terms)


@pytest.mark.parametrize("load", [0.3, 0.6, 0.8])
def test_one_replica_is_the_queue_m_d_1(load: float) -> None:
    taken = fleet_sojourn_times(10_000, load / 10_000, 1.0, 1, requests=400_000, seed=1)
    # Pollaczek and Khinchine's mean.
    assert np.mean(taken) - 1 == pytest.approx(load / (2 * (1 - load)), rel=0.04)
    for wait in (0.5, 1.0, 2.5):
        assert np.mean(taken - 1 <= wait) == pytest.approx(waiting_share(wait, load), abs=0.01)


def test_clients_with_fixed_moments_and_too_little_to_do_never_wait() -> None:
    taken = fleet_sojourn_times(1, 100.0, 0.009, 1, arrivals="steps", requests=1000)
    assert taken == pytest.approx(0.009)


def test_two_choices_wait_less_than_a_fixed_replica() -> None:
    fixed = fleet_sojourn_times(4000, 1 / 500, 0.9, 8, requests=50_000)
    choices = fleet_sojourn_times(4000, 1 / 500, 0.9, 8, balancing="two-choices", requests=50_000)
    assert np.percentile(choices, 99) < 0.5 * np.percentile(fixed, 99)


@settings(max_examples=50, deadline=None)
@given(
    gaps=st.lists(st.floats(0, 3), min_size=1, max_size=60),
    service=st.floats(0.1, 2),
    replicas=st.integers(1, 4),
)
def test_each_replica_serves_one_request_at_a_time(
    gaps: list[float], service: float, replicas: int
) -> None:
    arrivals = np.cumsum(gaps)
    taken = sojourn_times(arrivals, service, lambda number, _: number % replicas, replicas)
    ends = arrivals + taken
    assert (taken >= service - 1e-9).all()
    for replica in range(replicas):
        own = ends[replica::replicas]
        assert (np.diff(own) >= service - 1e-9).all()
        # A replica is never idle while a request waits for it.
        starts, before = own - service, np.concatenate([[0.0], own[:-1]])
        assert starts == pytest.approx(np.maximum(arrivals[replica::replicas], before))


def test_the_plan_is_the_least_number_that_keeps_the_bound() -> None:
    service = ServiceTime(request_s=90e-6, row_s=10e-6, way_s=0.2e-3)
    fleet = Fleet(fingers=4096, windows=1, rate=100.0)
    how = {"arrivals": "poisson", "balancing": "fixed", "requests": 50_000, "seed": 3}
    tried = plan(fleet, service, 0.6, **how)  # type: ignore[arg-type]
    assert tried[0].replicas == 52
    assert len(tried) > 1
    assert [each.replicas for each in tried] == list(range(tried[0].replicas, tried[-1].replicas + 1))
    assert all(each.p99_ms >= 0.6 for each in tried[:-1])
    assert tried[-1].p99_ms < 0.6
    assert plan(fleet, service, 0.6, **how) == tried  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="without any wait"):
        plan(fleet, service, 0.3, **how)  # type: ignore[arg-type]

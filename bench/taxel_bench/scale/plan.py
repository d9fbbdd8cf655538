"""How many replicas a fleet needs, so that p99 stays below a bound."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from taxel.errors import SettingsError
from taxel_bench.capacity.service_time import ServiceTime
from taxel_bench.scale.queueing import Arrivals, Balancing, fleet_sojourn_times

_FEWEST_A_REPLICA: Final = 2_000
"""Simulated requests at each replica: p99 needs 662."""

MOST_BUSY: Final = 0.8
"""The share of its time that a planned replica is busy at most. Above it, small errors decide."""


@dataclass(frozen=True)
class Fleet:
    """Fingers whose simulators each ask for some of them in one request a step.

    Attributes:
        fingers: of all simulators.
        windows: fingers of one simulator.
        rate: steps a second.
    """

    fingers: int
    windows: int
    rate: float

    @property
    def clients(self) -> int:
        """Simulators; the last one may have fewer fingers, and counts as a whole one."""
        return math.ceil(self.fingers / self.windows)


@dataclass(frozen=True)
class Replicas:
    """So many servers, and what the fleet gets from them.

    Attributes:
        replicas: servers.
        utilisation: the share of its time that each is busy.
        p50_ms, p99_ms: of a request, with its way.
    """

    replicas: int
    utilisation: float
    p50_ms: float
    p99_ms: float


def plan(
    fleet: Fleet,
    service: ServiceTime,
    bound_ms: float,
    *,
    arrivals: Arrivals,
    balancing: Balancing,
    requests: int,
    seed: int,
) -> list[Replicas]:
    """Add replicas until p99 is below the bound; the last one is the plan. None is busier than `MOST_BUSY`.

    Raises:
        SettingsError: a request takes longer than the bound even without a wait, or with a replica for each
            client.
    """
    service_s = service.of(fleet.windows)
    least_ms = (service_s + service.way_s) * 1e3
    if least_ms >= bound_ms:
        raise SettingsError(
            f"a request of {fleet.windows} windows takes {least_ms:.3g} ms without any wait: "
            f"no number of replicas brings p99 below {bound_ms:g} ms; "
            "expected fewer windows or a larger --latency-bound"
        )
    load = fleet.clients * fleet.rate * service_s
    count = max(math.ceil(load / MOST_BUSY), 1)
    tried: list[Replicas] = []
    while not tried or tried[-1].p99_ms >= bound_ms:
        if tried and count > fleet.clients:
            raise SettingsError(
                f"even with a replica for each of the {fleet.clients} clients, "
                f"p99 is {tried[-1].p99_ms:.3g} ms: expected fewer windows, "
                f"or a larger --latency-bound than {bound_ms:g}"
            )
        taken = fleet_sojourn_times(
            fleet.clients,
            fleet.rate,
            service_s,
            count,
            arrivals=arrivals,
            balancing=balancing,
            requests=max(requests, _FEWEST_A_REPLICA * count),
            seed=seed,
        )
        p50, p99 = (np.percentile(taken, (50, 99)) + service.way_s) * 1e3
        tried.append(Replicas(count, load / count, float(p50), float(p99)))
        count += 1
    return tried

"""Requests that queue at replicas: one after the other at each, all of the same service time.

With such a service, all that matters of a queue is when its replica will be free. So a simulation is one
loop over the arrivals, and needs no list of events.
"""

from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from taxel_bench.load.arrivals import poisson_arrivals

Arrivals = Literal["poisson", "steps"]
Balancing = Literal["fixed", "two-choices"]

SETTLING: Final = 0.1
"""The share of the requests at the beginning that do not count: the queues start empty."""


def sojourn_times(
    arrivals: NDArray[np.float64],
    service_s: float,
    choose: Callable[[int, list[float]], int],
    replicas: int,
) -> NDArray[np.float64]:
    """How long each request is at its replica, waiting and service, (n,), s.

    Args:
        arrivals: (n,), s, ascending.
        service_s: of every request.
        choose: the replica of a request, from its number and from when each replica will be free.
        replicas: how many there are.
    """
    free = [0.0] * replicas
    taken = np.empty(len(arrivals))
    for number, moment in enumerate(arrivals.tolist()):
        replica = choose(number, free)
        free[replica] = max(free[replica], moment) + service_s
        taken[number] = free[replica] - moment
    return taken


def fleet_sojourn_times(
    clients: int,
    rate: float,
    service_s: float,
    replicas: int,
    *,
    arrivals: Arrivals = "poisson",
    balancing: Balancing = "fixed",
    requests: int = 200_000,
    seed: int = 0,
) -> NDArray[np.float64]:
    """What clients of a fleet get once the queues have settled, (n,), s.

    Args:
        clients: that each ask at the rate.
        rate: requests of each client a second.
        service_s: of every request.
        replicas: how many there are.
        arrivals: `poisson`, as if each client came at random; `steps`, each client at its own fixed moment
            of a step.
        balancing: `fixed`, each client has its replica; `two-choices`, each request goes to that one of two
            random replicas which has less to do.
        requests: about so many are simulated.
        seed: of the arrivals and choices.
    """
    rng = np.random.default_rng(seed)
    if arrivals == "poisson":
        moments = poisson_arrivals(clients * rate, requests, seed)
        senders = rng.integers(clients, size=requests)
    else:
        steps = max(-(-requests // clients), 10)
        phases = np.sort(rng.random(clients))
        moments = ((np.arange(steps)[:, None] + phases) / rate).ravel()
        senders = np.tile(rng.permutation(clients), steps)
    count = len(moments)
    if balancing == "fixed":
        homes = (senders % replicas).tolist()
        taken = sojourn_times(moments, service_s, lambda number, _: homes[number], replicas)
    else:
        pairs = rng.integers(replicas, size=(count, 2)).tolist()
        taken = sojourn_times(
            moments, service_s, lambda number, free: min(pairs[number], key=free.__getitem__), replicas
        )
    return taken[int(SETTLING * count) :]

"""What a request costs a server, measured: so much for each request, and so much for each window in it."""

from typing import Final, NamedTuple

import numpy as np
import psutil

from taxel.remote.options import Transport
from taxel_bench.capacity.clients import ask_in_turn
from taxel_bench.capacity.search import Generator

FEW: Final = 1
MANY: Final = 512
"""Windows of the two kinds of requests that are measured."""


class ServiceTime(NamedTuple):
    """Of one model over one transport.

    Attributes:
        request_s: the server's processor time for a request, apart from its windows.
        row_s: for each window.
        way_s: what is left of a round trip with one window: the client, the system, waking threads.
    """

    request_s: float
    row_s: float
    way_s: float

    def of(self, rows: int) -> float:
        """Seconds for a request of so many windows."""
        return self.request_s + rows * self.row_s


def measure_service_time(
    generator: Generator, model: str, transport: Transport, seconds: float
) -> ServiceTime:
    """Ask one client's requests in turn, small ones and large ones; from the server's processor time.

    Processor time does not count what other programs take. As one thread's work it is an upper bound: the
    server's threads can share two cores.

    Raises:
        RequestError: a request was not answered.
    """
    process = psutil.Process(generator.server.pid)
    cost: list[float] = []
    round_trip: list[float] = []
    for rows in (FEW, MANY):
        asking = (generator.server.endpoint, transport, model, rows)
        generator.pool.submit(ask_in_turn, *asking, 0.2).result()
        before = process.cpu_times()
        taken = generator.pool.submit(ask_in_turn, *asking, seconds).result()
        after = process.cpu_times()
        cost.append((after.user + after.system - before.user - before.system) / len(taken))
        round_trip.append(float(np.median(taken)))
    row_s = max((cost[1] - cost[0]) / (MANY - FEW), 0.0)
    request_s = max(cost[0] - FEW * row_s, 0.0)
    return ServiceTime(request_s, row_s, max(round_trip[0] - cost[0], 0.0))

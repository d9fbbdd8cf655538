"""Whether other programs disturbed a measurement: the machine's load and the steadiness of the times."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

import psutil

from taxel_bench.timing import TimedCalls

LEAST_RUNNING: Final = 0.95
"""The least processors that a call must use: other programs may take no more than 5 % of its time."""

MOST_RUNNING: Final = 1.1
"""The most processors that a call may use: more means that it computed with several threads."""

MOST_STOLEN: Final = 0.02
"""Share of the processors' time that a hypervisor may give to other machines."""

MOST_DRIFT: Final = 0.1
"""By how much the medians of a measurement's two halves may differ."""


@contextmanager
def stolen_time() -> Iterator[Callable[[], float]]:
    """Yield what tells, once the block has ended, which share of the processors' time was given away.

    A hypervisor counts it; 0 where there is none, or where it does not say.
    """
    before = psutil.cpu_times()
    after = before
    yield lambda: _stolen([late - early for late, early in zip(after, before, strict=True)], before._fields)
    after = psutil.cpu_times()


def _stolen(spent: list[float], names: tuple[str, ...]) -> float:
    if "steal" not in names or sum(spent) <= 0:
        return 0.0
    # Over an instant the kernel's counters are coarse, and that of waiting may fall.
    return min(1.0, max(0.0, spent[names.index("steal")] / sum(spent)))


def disturbances(calls: TimedCalls, stolen: float) -> list[str]:
    """Why latencies are not to be trusted; nothing where they are.

    Args:
        stolen: share of all processors' time that the hypervisor gave away meanwhile.
    """
    reasons = []
    if calls.running < LEAST_RUNNING:
        reasons.append(
            f"other programs took {1 - calls.running:.0%} of the calls' time: "
            f"at most {1 - LEAST_RUNNING:.0%} is allowed"
        )
    if calls.running > MOST_RUNNING:
        reasons.append(f"the calls used {calls.running:.2g} processors: expected one thread")
    if stolen > MOST_STOLEN:
        reasons.append(
            f"the hypervisor gave {stolen:.0%} of the processors' time to other machines: "
            f"at most {MOST_STOLEN:.0%} is allowed"
        )
    if calls.drift > MOST_DRIFT:
        reasons.append(
            f"the medians of the two halves differ by {calls.drift:.0%}: "
            f"at most {MOST_DRIFT:.0%} is allowed"
        )
    return reasons

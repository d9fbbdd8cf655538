"""Statistics of a model since the server started: requests, rows, errors, batch sizes, times."""

from collections import Counter
from typing import Any

from taxel.protocol import InferResponse


class Histogram:
    """Counts of whole numbers in buckets that double: bucket b holds b/2 < value <= b."""

    def __init__(self) -> None:
        self._count = 0
        self._sum = 0
        self._max = 0
        self._buckets = [0] * 65
        """Counts by the power of two that ends the bucket."""

    def add(self, value: int) -> None:
        """Count one value, 0 or above; 0 goes into the first bucket."""
        self._count += 1
        self._sum += value
        if value > self._max:
            self._max = value
        self._buckets[(value - 1).bit_length() if value else 0] += 1

    def as_dict(self) -> dict[str, Any]:
        """As on the wire: buckets by their upper end, ascending."""
        buckets = {str(1 << power): count for power, count in enumerate(self._buckets) if count}
        return {"count": self._count, "sum": self._sum, "max": self._max, "buckets": buckets}


class ModelStatistics:
    """Counters of one model. Written under the batcher's lock; read at any time.

    Attributes:
        requests: answered, failed and cancelled ones.
    """

    def __init__(self) -> None:
        self.requests = 0
        self._rows = 0
        self._errors: Counter[str] = Counter()
        self._cancelled = 0
        self._cancelled_rows = 0
        self._batch_rows = Histogram()
        self._queue_us = Histogram()
        self._compute_us = Histogram()

    def add_response(self, response: InferResponse) -> None:
        """Count a request that was answered with predictions."""
        self.requests += 1
        self._rows += len(response.outputs)
        self._queue_us.add(response.queue_us)
        self._compute_us.add(response.compute_us)

    def add_alone(self, rows: int, compute_us: int) -> None:
        """Count a request that was evaluated at once, by itself."""
        self.requests += 1
        self._rows += rows
        self._batch_rows.add(rows)
        self._queue_us.add(0)
        self._compute_us.add(compute_us)

    def add_error(self, code: str) -> None:
        """Count a request that was refused or failed."""
        self.requests += 1
        self._errors[code] += 1

    def add_cancelled(self, rows: int) -> None:
        """Count a request that was dropped because nobody waits for it, with windows not evaluated."""
        self.requests += 1
        self._cancelled += 1
        self._cancelled_rows += rows

    def add_batch(self, rows: int) -> None:
        """Count one evaluation."""
        self._batch_rows.add(rows)

    def as_dict(self) -> dict[str, Any]:
        """As on the wire; `requests` counts answered, failed and cancelled requests."""
        return {
            "requests": self.requests,
            "rows": self._rows,
            "errors": dict(self._errors),
            "cancelled": {"requests": self._cancelled, "rows": self._cancelled_rows},
            "batch_rows": self._batch_rows.as_dict(),
            "queue_us": self._queue_us.as_dict(),
            "compute_us": self._compute_us.as_dict(),
        }

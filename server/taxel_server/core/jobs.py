"""A request in the server: as it arrived, and while it is evaluated."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from math import inf
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import DeadlineExceeded, InvalidArgument, RequestError
from taxel.protocol import InferRequest, InferResponse
from taxel.trace_context import trace_id_of
from taxel.windows.checks import check_values
from taxel_server.core.policy import Ticket
from taxel_server.engine import LoadedModel

_CHANNELS: Final = len(CHANNELS)


def check_shape(model: LoadedModel, shape: tuple[int, ...]) -> None:
    """Raise if a model does not take windows of a shape.

    Raises:
        InvalidArgument: another number of features, or no rows.
    """
    features = len(model.manifest.window.features)
    if shape[1] != features or not shape[0]:
        raise InvalidArgument(f"inputs[0].shape: {list(shape)}: expected [n, {features}] for {model.label}")


class Job(Ticket, ABC):
    """A request as it arrived: not decoded yet. It must be answered exactly once.

    Args:
        model: which model it is for.
        rows: how many windows it counts for while it is queued, at least 1.
        size: its bytes.
        client: who asks. Clients that cannot be told from each other are one client.
        source: the connection that it came by; the client if none.
        name: what the client calls it if it gives it up.

    Attributes:
        caller: what the client is called in logs, as far as the transport knows.
        request_id: the client's own id, once it is known.
        traceparent: the W3C's, of the trace that it belongs to, once it is known.
        seen: told the answer once it is given, if somebody watches.
        arrived: when, on the clock `time.monotonic`.
        work: the decoded request, once its evaluation has begun.
    """

    model: LoadedModel
    caller: str = ""
    request_id: str | int | None = None
    traceparent: str | None = None
    seen: "Callable[[Job, InferResponse | RequestError], None] | None" = None

    def __init__(
        self,
        model: LoadedModel,
        rows: int,
        size: int = 0,
        client: Hashable = None,
        source: Hashable = None,
        name: Hashable = None,
    ) -> None:
        super().__init__(client, model, rows, size, source=source, name=name)
        self.arrived = time.monotonic()
        self.work: Work | None = None

    @property
    def log_fields(self) -> dict[str, dict[str, object]]:
        """What a line of the log tells of it."""
        told = {
            "client": self.caller,
            "request_id": self.request_id,
            "trace_id": trace_id_of(self.traceparent),
        }
        return {"fields": {name: value for name, value in told.items() if value not in (None, "")}}

    @abstractmethod
    def decode(self) -> InferRequest:
        """Decode the request.

        Raises:
            RequestError: it is not a valid request.
        """

    @abstractmethod
    def answer(self, result: InferResponse | RequestError) -> None:
        """Give the one answer."""


def too_late(job: Job, now: float) -> DeadlineExceeded:
    """The error of a job whose deadline is over."""
    timeout_ms, waited_ms = (job.deadline - job.arrived) * 1e3, (now - job.arrived) * 1e3
    return DeadlineExceeded(f"parameters.timeout_ms: {timeout_ms:.4g}: {waited_ms:.0f} ms have passed")


class Work:
    """A decoded request, evaluated at once or, if it is large, piece by piece.

    Raises:
        RequestError: the request is wrong, or wrong for its model.
    """

    def __init__(self, job: Job) -> None:
        self.job: Final = job
        self._request: Final = job.decode()
        request = self._request
        check_shape(job.model, request.windows.shape)
        check_values(request.windows, job.model.manifest.window.features)
        if request.spread and not job.model.manifest.gives_spread:
            raise InvalidArgument(f"outputs[1]: {job.model.label} gives no spread: expected an ensemble")
        self.deadline: Final = inf if request.timeout_ms is None else job.arrived + request.timeout_ms / 1e3
        """After it, the caller waits no longer."""
        self._outputs: NDArray[np.float32] | None = None
        self._done = 0
        self._started: float | None = None
        self._compute_s = 0.0
        self._batch_rows = 0

    @property
    def rows(self) -> int:
        """All its windows."""
        return len(self._request.windows)

    @property
    def left(self) -> int:
        """Windows still to evaluate."""
        return self.rows - self._done

    def next_windows(self, rows: int) -> NDArray[np.float32]:
        """The next windows to evaluate, at most so many."""
        return self._request.windows[self._done : self._done + rows]

    def keep(self, outputs: NDArray[np.float32], *, started: float, ended: float, batch_rows: int) -> None:
        """Keep the outputs (m, columns) of the next m windows, with their times."""
        if len(outputs) == len(self._request.windows):
            self._outputs = outputs
        else:
            if self._outputs is None:
                self._outputs = np.empty((len(self._request.windows), outputs.shape[1]), np.float32)
            self._outputs[self._done : self._done + len(outputs)] = outputs
        self._done += len(outputs)
        self._started = started if self._started is None else self._started
        self._compute_s += ended - started
        self._batch_rows = max(self._batch_rows, batch_rows)

    def response(self) -> InferResponse:
        """The answer, once nothing is left."""
        assert self._outputs is not None
        assert self._started is not None
        manifest, outputs = self.job.model.manifest, self._outputs
        return InferResponse(
            outputs[:, :_CHANNELS],
            manifest.name,
            manifest.version,
            self._request.id,
            round((self._started - self.job.arrived) * 1e6),
            round(self._compute_s * 1e6),
            self._batch_rows,
            outputs[:, _CHANNELS:] if self._request.spread else None,
        )

"""A request in the server: as it arrived, and while it is evaluated."""

import time
from abc import ABC, abstractmethod
from math import inf
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.channels import CHANNELS
from taxel.errors import DeadlineExceeded, InvalidArgument, RequestError
from taxel.protocol import InferRequest, InferResponse
from taxel.windows.checks import check_finite
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


class Job(ABC):
    """A request as it arrived: not decoded yet. It must be answered exactly once.

    Args:
        model: which model it is for.
        rows: how many windows it counts for while it is queued, at least 1.

    Attributes:
        client: who asks, as far as the transport knows.
        request_id: the client's own id, once it is known.
    """

    client: str = ""
    request_id: str | int | None = None

    def __init__(self, model: LoadedModel, rows: int) -> None:
        self.model: Final = model
        self.rows: Final = rows
        self.arrived = time.monotonic()

    @abstractmethod
    def decode(self) -> InferRequest:
        """Decode the request.

        Raises:
            RequestError: it is not a valid request.
        """

    @abstractmethod
    def answer(self, result: InferResponse | RequestError) -> None:
        """Give the one answer."""


def checked_request(job: Job) -> InferRequest:
    """The decoded request of a job.

    Raises:
        RequestError: the request is wrong, or wrong for its model.
    """
    request = job.decode()
    manifest = job.model.manifest
    check_shape(job.model, request.windows.shape)
    check_finite(request.windows, manifest.window.features)
    if request.spread and not manifest.gives_spread:
        raise InvalidArgument(f"outputs[1]: {job.model.label} gives no spread: expected an ensemble")
    return request


def response_of(
    job: Job,
    request: InferRequest,
    outputs: NDArray[np.float32],
    started: float,
    compute_s: float,
    batch_rows: int,
) -> InferResponse:
    """The answer to a request, from the outputs (n, columns) of all its windows and their times."""
    manifest = job.model.manifest
    return InferResponse(
        outputs if outputs.shape[1] == _CHANNELS else outputs[:, :_CHANNELS],
        manifest.name,
        manifest.version,
        request.id,
        round((started - job.arrived) * 1e6),
        round(compute_s * 1e6),
        batch_rows,
        outputs[:, _CHANNELS:] if request.spread else None,
    )


class Work:
    """A decoded request, evaluated at once or, if it is large, piece by piece.

    Raises:
        RequestError: the request is wrong, or wrong for its model.
    """

    def __init__(self, job: Job) -> None:
        self.job: Final = job
        self._request: Final = checked_request(job)
        request = self._request
        self._timeout_s: Final = inf if request.timeout_ms is None else request.timeout_ms / 1e3
        self._outputs: NDArray[np.float32] | None = None
        self._done = 0
        self._started: float | None = None
        self._compute_s = 0.0
        self._batch_rows = 0

    @property
    def left(self) -> int:
        """Windows still to evaluate."""
        return len(self._request.windows) - self._done

    def next_windows(self, rows: int) -> NDArray[np.float32]:
        """The next windows to evaluate, at most so many."""
        return self._request.windows[self._done : self._done + rows]

    def check_deadline(self, now: float) -> None:
        """Raise if the caller has stopped waiting.

        Raises:
            DeadlineExceeded: the time that the caller allowed is over.
        """
        waited = now - self.job.arrived
        if waited > self._timeout_s:
            raise DeadlineExceeded(
                f"parameters.timeout_ms: {self._timeout_s * 1e3:g}: {waited * 1e3:.0f} ms have passed"
            )

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
        return response_of(
            self.job, self._request, self._outputs, self._started, self._compute_s, self._batch_rows
        )

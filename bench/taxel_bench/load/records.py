"""What is kept of each query: when it was due, sent and answered, and what the server said of it."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxel.errors import Internal, RequestError
from taxel.protocol import InferResponse, unpack_infer_response

RECORD: Final = np.dtype(
    [
        ("scheduled", np.float64),
        ("sent", np.float64),
        ("answered", np.float64),
        ("queue_us", np.int64),
        ("compute_us", np.int64),
        ("code", "U24"),
    ]
)
"""Times are seconds from the run's start; `code` is empty for an answer, else the error's."""

Records = NDArray[np.void]
"""(queries,) of `RECORD`."""

Record = tuple[float, float, float, int, int, str]
"""One row of `RECORD`."""


def record(
    scheduled: float,
    sent: float,
    answered: float,
    result: bytes | InferResponse | RequestError,
    samples: int,
) -> Record:
    """The record of one query from its answer, or from the error that came instead."""
    try:
        if isinstance(result, RequestError):
            raise result
        response = unpack_infer_response(result) if isinstance(result, bytes) else result
        if len(response.outputs) != samples:
            raise Internal(f"the server answered {len(response.outputs)} rows to {samples} windows")
    except RequestError as error:
        return scheduled, sent, answered, 0, 0, error.code
    return scheduled, sent, answered, response.queue_us, response.compute_us, ""

"""Spans of OpenTelemetry for requests that carry a trace context: the request, its queue and its compute.

They are made once a request has its answer, from the times that the answer tells anyway. Where they go is
OpenTelemetry's business: whoever starts the server sets its global tracer provider, and without one they go
nowhere.
"""

import logging
import time
from typing import Any, Final, Self

from taxel import __version__
from taxel.errors import RequestError
from taxel.protocol import InferResponse
from taxel_server.core.jobs import Job

_LOG: Final = logging.getLogger(__name__)


class Spans:
    """Makes spans by OpenTelemetry's API. Thread-safe.

    Args:
        trace: the module `opentelemetry.trace`.
        propagator: reads a `traceparent`.
    """

    def __init__(self, trace: Any, propagator: Any) -> None:
        self._trace = trace
        self._propagator = propagator

    @classmethod
    def available(cls) -> Self | None:
        """None where OpenTelemetry's API is not installed."""
        try:
            from opentelemetry import trace
            from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator
        except ImportError:
            return None
        return cls(trace, TraceContextTextMapPropagator())

    def add(self, job: Job, traceparent: str, result: InferResponse | RequestError) -> None:
        """Make the spans of a job that has its answer now."""
        try:
            self._add(job, traceparent, result)
        except Exception:
            # Where spans go is not ours, and must not end the batcher's worker.
            _LOG.exception("%s: the spans of a request could not be made", job.model.label)

    def _add(self, job: Job, traceparent: str, result: InferResponse | RequestError) -> None:
        ended = time.time_ns()
        arrived = ended - round((time.monotonic() - job.arrived) * 1e9)
        tracer = self._trace.get_tracer("taxel", __version__)
        whole = tracer.start_span(
            f"infer {job.model.manifest.name}",
            self._propagator.extract({"traceparent": traceparent}),
            self._trace.SpanKind.SERVER,
            {
                "taxel.model": job.model.label,
                "taxel.rows": job.rows,
                "taxel.client": job.caller,
                "taxel.request_id": "" if job.request_id is None else str(job.request_id),
            },
            start_time=arrived,
        )
        within = self._trace.set_span_in_context(whole)
        if isinstance(result, RequestError):
            whole.set_attribute("taxel.code", result.code)
            whole.set_status(self._trace.StatusCode.ERROR, str(result))
            taken = ended
        else:
            taken = min(arrived + result.queue_us * 1000, ended)
            compute = tracer.start_span(
                "compute",
                within,
                attributes={"taxel.compute_us": result.compute_us, "taxel.batch_rows": result.batch_rows},
                start_time=taken,
            )
            compute.end(ended)
        tracer.start_span("queue", within, start_time=arrived).end(taken)
        whole.end(ended)

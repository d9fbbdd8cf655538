"""Prometheus metrics: put together from the core's statistics when somebody asks, never per request."""

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector
from typing_extensions import override

from taxel import __version__

_TIME_POWERS: Final = range(3, 24)
"""Buckets of times end at 2^n µs: 8 µs to 8.4 s."""

_ROWS_POWERS: Final = range(25)
"""Buckets of batches end at 2^n rows: 1 to 16,777,216."""

_MODEL: Final = ("model", "version")

_HISTOGRAMS: Final = (
    ("queue_seconds", "queue_us", _TIME_POWERS, 1e-6, "Time from a request's arrival to its evaluation."),
    (
        "compute_seconds",
        "compute_us",
        _TIME_POWERS,
        1e-6,
        "Time of a request's evaluations.",
    ),
    ("batch_rows", "batch_rows", _ROWS_POWERS, 1, "Windows that were evaluated together."),
)


def registry_of(read: Callable[[], Mapping[str, Any]], ready: Callable[[], bool]) -> CollectorRegistry:
    """The metrics of a server and its process.

    Args:
        read: the server's statistics, as `ServerStatistics.read` gives them.
        ready: whether it takes requests.
    """
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_ServerCollector(read, ready))
    ProcessCollector(registry=registry)
    PlatformCollector(registry=registry)
    return registry


class _ServerCollector(Collector):
    def __init__(self, read: Callable[[], Mapping[str, Any]], ready: Callable[[], bool]) -> None:
        self._read = read
        self._ready = ready

    @override
    def collect(self) -> Iterator[Metric]:
        for family in self._families(self._read()):
            # Requests are answered by threads that need the interpreter, too.
            time.sleep(0)
            yield family

    def _families(self, told: Mapping[str, Any]) -> Iterator[Metric]:
        info = GaugeMetricFamily("taxel_build_info", "Always 1, with the version.", labels=["version"])
        info.add_metric([__version__], 1)
        yield info
        yield _gauge("ready", "Whether the server takes requests.", self._ready())
        yield _gauge("uptime_seconds", "Since the core was made.", told["uptime_s"])
        yield _gauge("queue_rows", "Windows accepted and not yet answered.", told["queue"]["rows"])
        yield _gauge("queue_requests", "Requests accepted and not yet answered.", told["queue"]["requests"])
        if (delay := told["run_delay_s"]) is not None:
            yield CounterMetricFamily(
                "taxel_worker_run_delay_seconds",
                "Time that the evaluating thread was ready to run and waited for a processor.",
                value=delay,
            )
        connections = GaugeMetricFamily("taxel_connections", "Connected clients.", labels=["transport"])
        for transport, count in told["connections"].items():
            connections.add_metric([transport], count)
        yield connections
        refusals = CounterMetricFamily(
            "taxel_errors",
            "Requests that got an error.",
            labels=["code", "client"],
        )
        for code, client, count in told["refusals"]:
            refusals.add_metric([code, client], count)
        yield refusals
        loads = CounterMetricFamily(
            "taxel_version_loads",
            "Versions that were loaded or refused.",
            labels=["result"],
        )
        for result, count in told["loads"].items():
            loads.add_metric([result], count)
        yield loads
        yield from _of_models(told["models"])


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(f"taxel_{name}", text, value=value)


def _of_models(models: list[Mapping[str, Any]]) -> Iterator[Metric]:
    requests = CounterMetricFamily(
        "taxel_requests", "Requests, answered, refused or cancelled.", labels=_MODEL
    )
    rows = CounterMetricFamily("taxel_rows", "Windows that were answered.", labels=_MODEL)
    errors = CounterMetricFamily(
        "taxel_model_errors", "Requests that got an error, by its code.", labels=[*_MODEL, "code"]
    )
    cancelled = CounterMetricFamily(
        "taxel_cancelled_requests", "Requests that were dropped: nobody waited for them.", labels=_MODEL
    )
    cancelled_rows = CounterMetricFamily(
        "taxel_cancelled_rows", "Windows of these that were not evaluated.", labels=_MODEL
    )
    for model in models:
        place = [model["name"], model["version"]]
        cancelled.add_metric(place, model["cancelled"]["requests"])
        cancelled_rows.add_metric(place, model["cancelled"]["rows"])
        requests.add_metric(place, model["requests"])
        rows.add_metric(place, model["rows"])
        for code, count in sorted(model["errors"].items()):
            errors.add_metric([*place, code], count)
    yield from (requests, rows, errors, cancelled, cancelled_rows)
    yield from _of_shadows([model for model in models if "shadow" in model])
    for name, field, powers, unit, text in _HISTOGRAMS:
        family = HistogramMetricFamily(f"taxel_{name}", text, labels=_MODEL)
        for model in models:
            buckets, total = _buckets(model[field], powers, unit)
            family.add_metric([model["name"], model["version"]], buckets, total)
        yield family


def _of_shadows(models: list[Mapping[str, Any]]) -> Iterator[Metric]:
    rows = CounterMetricFamily(
        "taxel_shadow_rows", "Windows that shadows were given.", labels=[*_MODEL, "result"]
    )
    mean = GaugeMetricFamily(
        "taxel_shadow_mean_difference_counts", "Mean difference of a channel.", labels=_MODEL
    )
    most = GaugeMetricFamily(
        "taxel_shadow_max_difference_counts", "Largest difference of a channel.", labels=_MODEL
    )
    for model in models:
        place, shadow = [model["name"], model["version"]], model["shadow"]
        for result, count in shadow["rows"].items():
            rows.add_metric([*place, result], count)
        mean.add_metric(place, shadow["mean_difference"])
        most.add_metric(place, shadow["max_difference"])
    yield from (rows, mean, most)


def _buckets(
    histogram: Mapping[str, Any], powers: range, unit: float
) -> tuple[list[tuple[str, float]], float]:
    """Cumulative counts by upper end, and the sum, from a histogram as on the wire."""
    ends = {int(end): count for end, count in histogram["buckets"].items()}
    buckets = [
        (repr(float(2**power * unit)), float(sum(count for end, count in ends.items() if end <= 2**power)))
        for power in powers
    ]
    return [*buckets, ("+Inf", float(histogram["count"]))], histogram["sum"] * unit

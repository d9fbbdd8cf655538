"""What a run says: throughput, latencies as far as they are supported, usage, and whether it is valid."""

from collections import Counter
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel_bench.load.drive import Outcome
from taxel_bench.load.records import Records
from taxel_bench.load.settings import RULES, LoadSettings
from taxel_bench.load.usage import ServerUsage
from taxel_bench.timing import Latencies
from taxel_bench.verdict import queries_for, too_few, verdict

PERCENTILES: Final = (50, 90, 95, 99, 99.9)

OFFLINE_SAMPLES: Final = 24_576
"""MLPerf's least number of samples for a throughput."""

LATE_MS: Final = 1.0
LATE_SHARE: Final = 0.01
"""A client that sends more than this share of its queries later than that has not kept its schedule."""

Percentiles = dict[str, float | None]
"""ms by `p50` … `p99.9` and `max`; None where there were too few queries for the percentile."""


@dataclass(frozen=True)
class Results:
    """The figures of a run; its fields are the keys of `results` in the JSON object.

    Attributes:
        verdict: `VALID` or `INVALID`.
        reasons: why it is invalid.
        sent: queries; always `answered` plus the sum of `errors`.
        answered: with predictions.
        errors: queries that were not, by the error's code.
        seconds: from the start to the last answer.
        queries_per_s: answered queries a second.
        samples_per_s: answered windows a second.
        latency_ms: of answered queries, from when each was due; for streams, from when it was sent.
        late_ms: how much later than due queries were sent; None except in the server scenario.
        queue_ms: time that answered queries waited in the server.
        compute_ms: time that the server evaluated the batches they were in.
        batches: evaluations, and the sum of their rows.
        batch_rows: evaluations by their rows; a bucket b holds b/2 < rows <= b.
        server_cpu_us: the server's processor time a query; None where it runs on another machine.
        clients_cpu_us: the client processes' processor time a query.
    """

    verdict: str
    reasons: list[str]
    sent: int
    answered: int
    errors: dict[str, int]
    seconds: float
    queries_per_s: float
    samples_per_s: float
    latency_ms: Percentiles
    late_ms: Percentiles | None
    queue_ms: Percentiles
    compute_ms: Percentiles
    batches: dict[str, int]
    batch_rows: dict[str, int]
    server_cpu_us: float | None
    clients_cpu_us: float

    def of_gap(self) -> dict[str, float | None]:
        """The figures that `bench compare` tells for a pause, too."""
        return {
            "p50_ms": self.latency_ms["p50"],
            "p99_ms": self.latency_ms["p99"],
            "cpu_us": self.server_cpu_us,
        }

    @classmethod
    def of(cls, settings: LoadSettings, outcome: Outcome) -> Self:
        """The figures of the settings' outcome."""
        records, server = outcome.records, outcome.server
        answered = records[records["code"] == ""]
        sent = len(records)
        seconds = float(records["answered"].max(initial=0.0))
        per_second = len(answered) / seconds if seconds else 0.0
        cpu_s = server.cpu_s
        return cls(
            **verdict(_reasons(settings, records, answered, server)),
            sent=sent,
            answered=len(answered),
            errors=_errors(records),
            seconds=seconds,
            queries_per_s=per_second,
            samples_per_s=per_second * settings.samples_per_query,
            latency_ms=_percentiles(_latencies(answered)),
            late_ms=_percentiles(_lateness(records)) if settings.scenario == "server" else None,
            queue_ms=_percentiles(answered["queue_us"] / 1e6),
            compute_ms=_percentiles(answered["compute_us"] / 1e6),
            batches={"count": server.batches, "rows": server.batch_rows},
            batch_rows=server.batch_buckets,
            server_cpu_us=None if cpu_s is None else cpu_s / max(sent, 1) * 1e6,
            clients_cpu_us=outcome.clients_cpu_s / max(sent, 1) * 1e6,
        )


def _latencies(answered: Records) -> NDArray[np.float64]:
    """Seconds from when each query was due, so that a client held up does not hide its waiting."""
    seconds: NDArray[np.float64] = answered["answered"] - answered["scheduled"]
    return seconds


def _lateness(records: Records) -> NDArray[np.float64]:
    seconds: NDArray[np.float64] = records["sent"] - records["scheduled"]
    return seconds


def _percentiles(seconds: NDArray[Any]) -> Percentiles:
    latencies = Latencies(np.asarray(seconds, np.float64))
    figures: Percentiles = {
        f"p{share:g}": latencies.percentile_ms(share) if len(seconds) >= queries_for(share) else None
        for share in PERCENTILES
    }
    return figures | {"max": float(seconds.max()) * 1e3 if len(seconds) else None}


def _errors(records: Records) -> dict[str, int]:
    return dict(sorted(Counter(code for code in records["code"].tolist() if code).items()))


def _reasons(settings: LoadSettings, records: Records, answered: Records, server: ServerUsage) -> list[str]:
    """The reasons why a run is not valid."""
    reasons = _shortage(settings, len(answered))
    if errors := _errors(records):
        told = ", ".join(f"{count} {code}" for code, count in errors.items())
        reasons.append(f"{sum(errors.values())} of {len(records)} queries were not answered: {told}")
    if settings.scenario == "server" and len(records):
        late = float(np.mean(_lateness(records) > LATE_MS / 1e3))
        if late > LATE_SHARE:
            reasons.append(
                f"{late:.1%} of the queries were sent more than {LATE_MS:g} ms late: expected at most "
                f"{LATE_SHARE:.0%}; the clients could not keep their schedule"
            )
    if settings.latency_bound_ms is not None:
        reasons += _beyond(settings.latency_bound_ms, RULES[settings.scenario].percentile, answered)
    if server.requests > len(records):
        reasons.append(
            f"the server was asked {server.requests} times where {len(records)} queries were sent: "
            f"others used {settings.model} during the run"
        )
    return reasons


def _shortage(settings: LoadSettings, answered: int) -> list[str]:
    percentile = RULES[settings.scenario].percentile
    if percentile is not None:
        return too_few(answered, percentile)
    samples = answered * settings.samples_per_query
    if samples >= OFFLINE_SAMPLES:
        return []
    return [f"{samples} samples do not support a throughput: at least {OFFLINE_SAMPLES} are needed"]


def _beyond(bound_ms: float, percentile: float | None, answered: Records) -> list[str]:
    if percentile is None or not len(answered):
        return []
    found = Latencies(_latencies(answered)).percentile_ms(percentile)
    return (
        [f"p{percentile:g} is {found:.3f} ms: expected at most {bound_ms:g} ms"] if found > bound_ms else []
    )

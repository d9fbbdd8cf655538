"""What a load run sends: one of MLPerf's scenarios, and how much of it."""

from dataclasses import dataclass
from typing import Final, Literal, Self

from taxel.errors import SettingsError

Scenario = Literal["single-stream", "multi-stream", "server", "offline"]
Server = Literal["taxel", "taxel-lane"]
"""Taxel asked over zenoh, or over its lane."""

STREAMS: Final[tuple[Scenario, ...]] = ("single-stream", "multi-stream")
"""Scenarios in which a client sends each query after the answer to the last."""

DURATION_S: Final = 10.0
RATE_QPS: Final = 500.0
TIMEOUT_S: Final = 10.0


@dataclass(frozen=True)
class Rules:
    """What a scenario fixes.

    Attributes:
        percentile: of the latency, that the scenario is judged by; None where its throughput is.
        samples_per_query: unless the user says otherwise.
        queries: unless the user says otherwise; None where a duration decides.
    """

    percentile: float | None
    samples_per_query: int
    queries: int | None = None


RULES: Final[dict[Scenario, Rules]] = {
    "single-stream": Rules(percentile=90, samples_per_query=1),
    "multi-stream": Rules(percentile=99, samples_per_query=8),
    "server": Rules(percentile=99, samples_per_query=1),
    "offline": Rules(percentile=None, samples_per_query=1024, queries=96),
}
"""After MLPerf Inference's rules: https://github.com/mlcommons/inference_policies, "Scenarios"."""


@dataclass(frozen=True)
class LoadSettings:
    """One run, checked; made by `LoadSettings.of`.

    Attributes:
        scenario: how queries follow each other.
        model: the name of a served model; its newest version is asked.
        clients: processes, each with a connection of its own.
        samples_per_query: windows in one query.
        queries: how many are sent in all; None in streams that last for `duration_s`.
        duration_s: for how long queries are sent; None where only `queries` were given.
        rate_qps: mean arrival rate over all clients, only of the server scenario.
        latency_bound_ms: what the scenario's percentile may not exceed.
        timeout_s: how long an answer is waited for.
        seed: of the arrivals and the windows.
        server: which of Taxel's two is asked.
        gap_ms: pause between an answer and the next query, in streams.
    """

    scenario: Scenario
    model: str
    clients: int
    samples_per_query: int
    queries: int | None
    duration_s: float | None
    rate_qps: float | None
    latency_bound_ms: float | None
    timeout_s: float
    seed: int
    server: Server = "taxel"
    gap_ms: float = 0

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        model: str,
        *,
        clients: int = 1,
        samples_per_query: int | None = None,
        queries: int | None = None,
        duration_s: float | None = None,
        rate_qps: float | None = None,
        latency_bound_ms: float | None = None,
        timeout_s: float = TIMEOUT_S,
        seed: int = 0,
        server: Server = "taxel",
        gap_ms: float = 0,
    ) -> Self:
        """Settings with the scenario's own defaults where nothing is said.

        Raises:
            SettingsError: the options contradict each other or the scenario.
        """
        rules = RULES[scenario]
        samples = rules.samples_per_query if samples_per_query is None else samples_per_query
        if scenario == "single-stream" and samples != 1:
            raise SettingsError(f"--samples-per-query {samples}: single-stream sends 1; see multi-stream")
        if scenario != "server" and rate_qps is not None:
            raise SettingsError(f"--rate {rate_qps:g}: only the server scenario has a rate")
        if scenario not in STREAMS and (server != "taxel" or gap_ms):
            raise SettingsError(
                f"--server {server}, --gap-ms {gap_ms:g}: {scenario} has many queries in flight: "
                f"expected {' or '.join(STREAMS)}"
            )
        if rules.percentile is None and latency_bound_ms is not None:
            raise SettingsError(f"--latency-bound {latency_bound_ms:g}: {scenario} is judged by throughput")
        if scenario == "server" and rate_qps is None:
            rate_qps = RATE_QPS
        queries, duration_s = _extent(scenario, queries, duration_s, rate_qps)
        if queries is not None and queries < clients:
            raise SettingsError(f"--clients {clients}: more than the {queries} queries that they share")
        return cls(
            scenario=scenario,
            model=model,
            clients=clients,
            samples_per_query=samples,
            queries=queries,
            duration_s=duration_s,
            rate_qps=rate_qps,
            latency_bound_ms=latency_bound_ms,
            timeout_s=timeout_s,
            seed=seed,
            server=server,
            gap_ms=gap_ms,
        )

    def share(self, client: int) -> int | None:
        """How many of the queries one client sends, counted from client 0; None without a count."""
        return None if self.queries is None else len(range(client, self.queries, self.clients))


def _extent(
    scenario: Scenario, queries: int | None, duration_s: float | None, rate_qps: float | None
) -> tuple[int | None, float | None]:
    """How many queries, and for how many seconds; at least one of the two."""
    if queries is not None and duration_s is not None:
        raise SettingsError(f"--queries {queries} and --duration {duration_s:g}: expected one of the two")
    if scenario == "offline" and duration_s is not None:
        raise SettingsError(f"--duration {duration_s:g}: offline sends all at once; see --queries")
    if queries is not None:
        return queries, None
    if RULES[scenario].queries is not None:
        return RULES[scenario].queries, None
    seconds = DURATION_S if duration_s is None else duration_s
    # Arrivals are counted beforehand, so that a seed gives the same ones each time.
    return (None if rate_qps is None else max(1, round(rate_qps * seconds))), seconds

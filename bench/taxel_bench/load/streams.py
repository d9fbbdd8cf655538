"""How one client sends its queries: each after the answer to the last, or each when it is due."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from taxel.errors import RequestError, Unavailable
from taxel.protocol import InferResponse, model_key
from taxel.remote import RemoteSource
from taxel_bench.load.arrivals import poisson_arrivals
from taxel_bench.load.in_flight import QueriesInFlight
from taxel_bench.load.queries import drawn_queries, encoded_queries
from taxel_bench.load.records import RECORD, Record, Records, record
from taxel_bench.load.settings import STREAMS, LoadSettings

_PATIENCE_S: Final = 1.0
"""How much longer than its timeout a query in flight is waited for."""


@dataclass(frozen=True)
class Stream:
    """One client's connection, and the queries that it sends over it.

    Attributes:
        source: the connection.
        key: of the queries.
        payloads: the encoded queries that are sent again and again; none over the lane.
        asks: for each of them, sends it and waits for the answer.
        settings: of the run.
        client: this client's number.
    """

    source: RemoteSource
    key: str
    payloads: list[bytes]
    asks: list[Callable[[], bytes | InferResponse]]
    settings: LoadSettings
    client: int

    @classmethod
    def of(cls, source: RemoteSource, settings: LoadSettings, client: int) -> Self:
        """Ask for the model and encode queries for it.

        Raises:
            NotFound: the server has no such model.
        """
        predictor = source.predictor(settings.model)
        manifest = predictor.manifest
        what = (manifest, settings.samples_per_query, settings.seed, client)
        key = model_key(source.prefix, manifest.name, manifest.version, "infer")
        payloads: list[bytes] = []
        asks: list[Callable[[], bytes | InferResponse]]
        if settings.server == "taxel":
            payloads = encoded_queries(*what)
            asks = [partial(source.get, key, payload) for payload in payloads]
        else:
            asks = [partial(predictor.infer, windows) for windows in drawn_queries(*what)]
        return cls(source, key, payloads, asks, settings, client)

    def warm_up(self, queries: int) -> None:
        """Send queries that do not count, one after the other.

        Raises:
            RequestError: one is not answered with predictions.
        """
        for number in range(queries):
            self.asks[number % len(self.asks)]()

    def run(self, start: float) -> Records:
        """Send this client's part of the queries from `start` on, on the clock `time.perf_counter`.

        Ends early when the server has gone.
        """
        _sleep_until(start)
        if self.settings.scenario in STREAMS:
            return self._one_after_the_other(start)
        return self._when_due(start)

    def _one_after_the_other(self, start: float) -> Records:
        share = self.settings.share(self.client)
        most = inf if share is None else share
        ends = start + (self.settings.duration_s or inf)
        kept: list[Record] = []
        result: bytes | InferResponse | RequestError = b""
        while len(kept) < most and time.perf_counter() < ends and not isinstance(result, Unavailable):
            ask = self.asks[len(kept) % len(self.asks)]
            sent = time.perf_counter() - start
            try:
                result = ask()
            except RequestError as error:
                result = error
            answered = time.perf_counter() - start
            kept.append(record(sent, sent, answered, result, self.settings.samples_per_query))
            if self.settings.gap_ms:
                time.sleep(self.settings.gap_ms / 1e3)
        return np.array(kept, RECORD)

    def _when_due(self, start: float) -> Records:
        schedule = self._schedule().tolist()
        in_flight = QueriesInFlight(len(schedule), self.settings.samples_per_query, start)
        for number, due in enumerate(schedule):
            _sleep_until(start + due)
            if in_flight.server_gone:
                break
            done = in_flight.depart(due)
            self.source.connection.send(self.key, self._payload(number), self.source.timeout, done)
        return in_flight.land(self.settings.timeout_s + _PATIENCE_S)

    def _schedule(self) -> NDArray[np.float64]:
        """When each of this client's queries is due; the arrivals are dealt to the clients in turn."""
        settings = self.settings
        assert settings.queries is not None
        if settings.rate_qps is None:
            due = np.zeros(settings.queries)
        else:
            due = poisson_arrivals(settings.rate_qps, settings.queries, settings.seed)
        return due[self.client :: settings.clients]

    def _payload(self, number: int) -> bytes:
        return self.payloads[number % len(self.payloads)]


def _sleep_until(moment: float) -> None:
    """Return at a moment of the clock `time.perf_counter`; at once where it has passed."""
    if (left := moment - time.perf_counter()) > 0:
        time.sleep(left)

"""The synchronous face: calls wait for their answers."""

import time
from collections.abc import Sequence
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.arguments import checked_flag, checked_microseconds
from taxel.errors import Unavailable
from taxel.lane.client import Lane
from taxel.lane.connection import ConnectionLost
from taxel.lane.repeated_request import RepeatedRequest
from taxel.predictor import DEFAULT_MODEL, ModelInfo, Predictor, PredictorSource, Timing
from taxel.protocol import PREFIX, InferResponse
from taxel.remote.core import NO_LANE, REPEATED_ROWS, RemoteCore, TransportName, with_grace
from taxel.remote.credentials import Credentials
from taxel.remote.options import ConnectOptions, Transport, lane_of, open_transport
from taxel.remote.query_transport import QueryTransport
from taxel.remote.remote_model import RemoteModel, timing_of
from taxel.remote.waiting import BlockingCalls, finished


class RemoteSource(PredictorSource):
    """A connection to a server. Thread-safe; one serves any number of predictors.

    The arguments and errors are those of `connect`.

    Attributes:
        connection: what carries metadata, and requests that take no lane.
        endpoint: where the server listens.
        prefix: the server's key prefix.
    """

    def __init__(
        self,
        endpoint: str | Sequence[str] | None = None,
        *,
        timeout: float = 5.0,
        prefix: str = PREFIX,
        shared_memory: bool = False,
        credentials: Credentials | None = None,
        transport: Transport | QueryTransport | None = None,
        spin_us: int = 0,
    ) -> None:
        options = ConnectOptions.checked(endpoint, timeout, prefix, shared_memory, credentials, transport)
        checked_microseconds("spin_us", spin_us)
        self.connection = open_transport(options)
        self._owns_connection = options.transport is None
        self.endpoint = self.connection.endpoint
        self.prefix = options.prefix
        self.core = RemoteCore(
            BlockingCalls(spin_us),
            self.connection,
            options.prefix,
            options.timeout,
            lane_of(options, self.connection),
        )
        if options.lane == "only" and self.transport != "lane":
            self.close()
            raise Unavailable(f"{self.endpoint}: {NO_LANE}")

    @property
    def timeout(self) -> float:
        """Seconds to wait for an answer if a call gives no timeout."""
        return self.core.timeout

    @property
    def retries(self) -> int:
        """How often a request was sent again to the same server or to another."""
        return self.core.retries

    @property
    def transport(self) -> TransportName:
        """How windows reach the server now."""
        finished(self.core.find_lane(time.monotonic() + self.timeout))
        return self.core.transport_name

    @property
    def lane_address(self) -> str | None:
        """Where the lane is that windows take; None if they take none."""
        lanes = self.core.lanes
        return lanes.lane.address if lanes is not None and lanes.lane is not None else None

    @override
    def close(self) -> None:
        """End all connections. Later calls raise `Unavailable`."""
        self.core.close()
        if self._owns_connection:
            self.connection.close()

    @override
    def models(self) -> list[ModelInfo]:
        return finished(self.core.models())

    @override
    def predictor(self, name: str = DEFAULT_MODEL, version: str | None = None) -> "RemotePredictor":
        return RemotePredictor(self, finished(self.core.model(name, version)))

    def ready(self) -> bool:
        """Whether the server is ready to predict; False also where nobody answers."""
        return finished(self.core.ready())

    def get(self, key: str, payload: bytes | None = None, timeout: float | None = None) -> bytes:
        """One query of a key, and its one answer, as docs/wire.md describes them.

        Raises:
            RequestError: the server's typed error; `Unavailable` if nobody answers,
                `DeadlineExceeded` if the answer does not come in time.
        """
        return finished(self.core.get(key, payload, timeout))


class RemotePredictor(Predictor):
    """One model of a server; made by `RemoteSource.predictor`."""

    def __init__(self, source: RemoteSource, model: RemoteModel) -> None:
        super().__init__(model.manifest)
        self._source = source
        self._core = source.core
        self._model = model
        self._repeated: dict[tuple[int, ...], RepeatedRequest] = {}
        """Requests of few windows, by their shape: a control loop repeats them."""

    @property
    def transport(self) -> TransportName:
        """How windows reach the server now: over its lane, over zenoh, or in memory."""
        return self._source.transport

    @overload
    def predict(
        self,
        windows: NDArray[Any],
        *,
        timeout: float | None = None,
        timing: Literal[False] = False,
        traceparent: str | None = None,
    ) -> NDArray[np.float32]: ...

    @overload
    def predict(
        self,
        windows: NDArray[Any],
        *,
        timeout: float | None = None,
        timing: Literal[True],
        traceparent: str | None = None,
    ) -> tuple[NDArray[np.float32], Timing]: ...

    @override
    def predict(
        self,
        windows: NDArray[Any],
        *,
        timeout: float | None = None,
        timing: bool = False,
        traceparent: str | None = None,
    ) -> NDArray[np.float32] | tuple[NDArray[np.float32], Timing]:
        """As `Predictor.predict`; with `timing`, also how long the server took.

        Args:
            windows: as for `Predictor.predict`.
            timeout: as for `Predictor.predict`.
            timing: whether to tell how long the server took.
            traceparent: the W3C's, of the trace that this call belongs to; the server's log and its spans
                name it.

        Returns:
            (n, 21) float32, counts; with `timing`, a pair of these and the `Timing`.
        """
        lanes = self._core.lanes
        lane = lanes.lane if lanes is not None else None
        if lane is not None and timeout is None and timing is False and traceparent is None:
            repeated = self._repeated.get(getattr(windows, "shape", ()))
            if repeated is not None and repeated.takes(windows):
                return self._repeat(lane, repeated, windows)
        reply = finished(
            self._core.infer(self._model, self.checked(windows), timeout, False, traceparent=traceparent)
        )
        if lane is not None and timeout is None and len(reply.outputs) <= REPEATED_ROWS:
            shape, wait = (len(reply.outputs), len(self._features)), self._core.timeout
            self._repeated[shape] = RepeatedRequest(self._model.path, shape, wait, with_grace(wait))
        return (reply.outputs, timing_of(reply)) if checked_flag("timing", timing) else reply.outputs

    def _repeat(
        self, lane: Lane, repeated: RepeatedRequest, windows: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Ask as often before: the shortest way, since its code has left the caches after a pause."""
        self._core.check_usable()
        began = time.monotonic()
        try:
            return lane.repeat(repeated, windows)
        except (ConnectionLost, OSError) as error:
            rows, failed = self.checked(windows), (error, began)
            return finished(self._core.infer(self._model, rows, None, False, failed=failed)).outputs

    @override
    def predict_base(self, windows: NDArray[Any], *, timeout: float | None = None) -> NDArray[np.float32]:
        self._model.check_gives_base()
        return self.predict(windows, timeout=timeout)

    @override
    def predict_with_spread(
        self, windows: NDArray[Any], *, timeout: float | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        reply = self.infer(windows, timeout=timeout, spread=True)
        assert reply.spread is not None
        return reply.outputs, reply.spread

    def infer(
        self,
        windows: NDArray[Any],
        *,
        timeout: float | None = None,
        spread: bool = False,
        traceparent: str | None = None,
    ) -> InferResponse:
        """Predict, and return the server's whole reply: predictions, and how long they took.

        Args:
            windows: as for `predict`.
            timeout: as for `predict`.
            spread: ask for an ensemble's spread, too.
            traceparent: as for `predict`.

        Raises:
            InvalidArgument: as `predict`; or the model is no ensemble and a spread is asked for.
            RequestError: no prediction could be had.
        """
        if spread:
            self.check_gives_spread()
        return finished(
            self._core.infer(self._model, self.checked(windows), timeout, spread, traceparent=traceparent)
        )


def connect(
    endpoint: str | Sequence[str] | None = None,
    *,
    timeout: float = 5.0,
    prefix: str = PREFIX,
    shared_memory: bool = False,
    credentials: Credentials | None = None,
    transport: Transport | QueryTransport | None = None,
    spin_us: int = 0,
) -> RemoteSource:
    """Connect to the server at an endpoint, or to several servers of the same models.

    Args:
        endpoint: where the server listens, such as `tcp/127.0.0.1:7447`; or a router with servers behind
            it; or a list of such. Each request goes to one of several servers, and to another one if that
            fails or is silent. Servers that come later are found.
        timeout: seconds to wait for the connection, and for an answer if a call gives no timeout.
        prefix: the server's key prefix.
        shared_memory: whether large requests go through shared memory, where the server allows it.
        credentials: user, password and certificates; if none, those of `TAXEL_CLIENT_…` in the environment,
            and of the table `[client]` in `taxel.toml`.
        transport: `lane` or `zenoh` for windows; if none, the lane where there is one, and else zenoh, as
            always for several servers and for routers. Or an open transport without an endpoint, such as
            `taxel_server.transports.memory.MemoryServer`; the source does not close it.
        spin_us: microseconds that the lane's reply is polled for before the thread sleeps; it takes a core.

    Raises:
        InvalidArgument: an argument is wrong; the text names it.
        PermissionDenied: the server turns this client away, or its certificate is not trusted.
        SettingsError: the credentials of the environment or of `taxel.toml` are wrong.
        Unavailable: nobody listens there; or the lane is asked for, and there is none; or this process
            was forked from one with a connection.
    """
    return RemoteSource(
        endpoint,
        timeout=timeout,
        prefix=prefix,
        shared_memory=shared_memory,
        credentials=credentials,
        transport=transport,
        spin_us=spin_us,
    )

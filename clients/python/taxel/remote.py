"""Predictors that a Taxel server evaluates, reached over zenoh or, on its machine, over the lane."""

import time
from collections.abc import Callable
from typing import Any, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from typing_extensions import override

from taxel.artifacts import is_name, is_version
from taxel.envelopes import RequestWriter
from taxel.errors import Internal, InvalidArgument, NotFound, Unavailable
from taxel.lane.client import ConnectionLost, Lane, RepeatedRequest
from taxel.lane.lookup import LaneLookup
from taxel.manifest import Manifest
from taxel.predictor import ModelInfo, Predictor, PredictorSource
from taxel.protocol import (
    PREFIX,
    InferResponse,
    model_key,
    model_path,
    unpack_infer_response,
    unpackb,
)
from taxel.remote_connection import Connection, ServerLost, checked_timeout

T = TypeVar("T")

Transport = Literal["zenoh", "lane"]
"""How windows reach a server. Metadata always come over zenoh."""

_LOOKUP_S: Final = 1.0
"""How long the server's metadata are waited for, to find its lane."""

_NO_LANE: Final = (
    "no lane: expected a server of this user on this machine that runs without --lane off; "
    "without transport='lane', zenoh is asked"
)

_RECONNECT_S: Final = 2.0
"""The longest that a call waits for a lost server: zenoh tries to connect again after 1 s."""

_REPEATED_ROWS: Final = 64
"""The most windows in a request whose other bytes are kept."""

_GRACE_S: Final = 0.25
"""How much longer a client waits than the server's deadline: time for the server's refusal."""


class RemoteSource(Connection, PredictorSource):
    """A connection to a server. Thread-safe; one serves any number of predictors.

    Args:
        endpoint: where the server listens, such as `tcp/127.0.0.1:7447`.
        timeout: seconds to wait for the connection, and for an answer if a call gives no timeout.
        prefix: the server's key prefix.
        shared_memory: whether large requests go through shared memory, where the server allows it.
        spin_us: microseconds that the lane's reply is polled for before the thread sleeps; it takes a core.
        transport: `lane` or `zenoh` for windows; if none, the lane where there is one, and else zenoh.

    Attributes:
        retries: how often a request was sent again because its connection was lost.

    Raises:
        InvalidArgument: that is no endpoint, or no transport.
        Unavailable: nobody listens there; or the lane is asked for, and there is none.
    """

    def __init__(
        self,
        endpoint: str,
        *,
        timeout: float = 5.0,
        prefix: str = PREFIX,
        shared_memory: bool = False,
        transport: Transport | None = None,
        spin_us: int = 0,
    ) -> None:
        if transport not in (None, "lane", "zenoh"):
            raise InvalidArgument(f"transport is {transport!r}: expected 'lane', 'zenoh' or None")
        super().__init__(endpoint, timeout, shared_memory=shared_memory)
        self.prefix = prefix
        self.retries = 0
        self.asked_transport = transport
        self.lanes: LaneLookup | None = None
        if transport != "zenoh":
            wait = min(self.timeout, _LOOKUP_S)
            self.lanes = LaneLookup(lambda: unpackb(self.get(f"{prefix}/v2", timeout=wait)), spin_us)
        if transport == "lane" and self.transport != "lane":
            self.close()
            raise Unavailable(f"{endpoint}: {_NO_LANE}")

    @property
    def transport(self) -> Transport:
        """How windows reach the server now."""
        return "lane" if self.lanes is not None and self.lanes.find() is not None else "zenoh"

    @override
    def close(self) -> None:
        """End all connections. Later calls raise `Unavailable`."""
        if self.lanes is not None:
            self.lanes.close()
        super().close()

    @override
    def models(self) -> list[ModelInfo]:
        return self._read(
            f"{self.prefix}/v2/repository/index",
            lambda index: [ModelInfo.read(model) for model in index["models"]],
        )

    @override
    def predictor(self, name: str, version: str | None = None) -> "RemotePredictor":
        if not is_name(name) or not (version is None or is_version(version)):
            raise NotFound(f"no model can be called {name!r}, version {version!r}")
        manifest = self._read(
            model_key(self.prefix, name, version),
            lambda described: Manifest.model_validate(described["parameters"]["manifest"]),
        )
        return RemotePredictor(self, manifest)

    def ready(self) -> bool:
        """Whether the server is ready to predict; False also where nobody answers."""
        try:
            return self._read(f"{self.prefix}/v2/health/ready", lambda health: bool(health["ready"]))
        except Unavailable:
            return False

    def _read(self, key: str, read: Callable[[Any], T]) -> T:
        """The server's answer at a key."""
        answer = self.get(key)
        try:
            return read(unpackb(answer))
        except (InvalidArgument, ValidationError, KeyError, TypeError) as error:
            raise Internal(f"{self.endpoint}: the answer to {key} is malformed: {error!r}") from None


class RemotePredictor(Predictor):
    """One model of a server; made by `RemoteSource.predictor`."""

    def __init__(self, source: RemoteSource, manifest: Manifest) -> None:
        super().__init__(manifest)
        self._source = source
        self._writer = RequestWriter()
        self._path = model_path(manifest.name, manifest.version, "infer")
        self._key = model_key(source.prefix, manifest.name, manifest.version, "infer")
        self._repeated: dict[tuple[int, ...], RepeatedRequest] = {}
        """Requests of few windows, by their shape: a control loop repeats them."""
        self._ask = source.asker(self._key, source.timeout + _GRACE_S)

    @property
    def transport(self) -> Transport:
        """How windows reach the server now: over its lane, or over zenoh."""
        return self._source.transport

    @override
    def predict(self, windows: NDArray[Any], *, timeout: float | None = None) -> NDArray[np.float32]:
        lanes = self._source.lanes
        lane = lanes.lane if lanes is not None else None
        if lane is not None and timeout is None:
            repeated = self._repeated.get(getattr(windows, "shape", ()))
            if repeated is not None and repeated.takes(windows):
                return self._repeat(lane, repeated, windows)
        counts = self.infer(windows, timeout=timeout).outputs
        if timeout is None and lane is not None and len(counts) <= _REPEATED_ROWS:
            shape, wait = (len(counts), len(self._features)), self._source.timeout
            self._repeated[shape] = RepeatedRequest(self._path, shape, wait, wait + _GRACE_S)
        return counts

    def _repeat(
        self, lane: Lane, repeated: RepeatedRequest, windows: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Ask as often before: the shortest way, since its code has left the caches after a pause."""
        started = time.monotonic()
        try:
            return lane.repeat(repeated, windows)
        except (ConnectionLost, OSError) as error:
            wait = self._source.timeout
            return self._inferred(self.checked(windows), wait, started + wait, False, error).outputs

    @override
    def predict_base(self, windows: NDArray[Any], *, timeout: float | None = None) -> NDArray[np.float32]:
        if self.manifest.effects:
            label = f"{self.manifest.name}/{self.manifest.version}"
            raise InvalidArgument(
                f"{label} is corrected, and a server gives corrected counts only: "
                "expected a model of taxel.load"
            )
        return self.predict(windows, timeout=timeout)

    @override
    def predict_with_spread(
        self, windows: NDArray[Any], *, timeout: float | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        response = self.infer(windows, timeout=timeout, spread=True)
        if response.spread is None or len(response.spread) != len(response.outputs):
            raise Internal("the server answered without the spread that was asked for")
        return response.outputs, response.spread

    def infer(
        self, windows: NDArray[Any], *, timeout: float | None = None, spread: bool = False
    ) -> InferResponse:
        """Predict, and return the server's whole reply: predictions, and how long they took.

        Args:
            windows: as for `predict`.
            timeout: as for `predict`.
            spread: ask for an ensemble's spread, too.

        Raises:
            InvalidArgument: as `predict`; or the model is no ensemble and a spread is asked for.
            RequestError: no prediction could be had.
        """
        if spread:
            self.check_gives_spread()
        wait = self._source.timeout if timeout is None else checked_timeout(timeout)
        return self._inferred(self.checked(windows), wait, time.monotonic() + wait, spread)

    def _inferred(
        self,
        rows: NDArray[np.float32],
        wait: float,
        ends: float,
        spread: bool,
        failed: Exception | None = None,
    ) -> InferResponse:
        """The reply; `failed` is what the lane did when it was asked a first time."""
        response = self._over_lane(rows, wait, ends, spread, failed)
        if response is None:
            response = unpack_infer_response(self._over_zenoh(rows, wait, ends, spread))
        if len(response.outputs) != len(rows):
            raise Internal(f"the server answered {len(response.outputs)} rows to {len(rows)} windows")
        return response

    def _over_zenoh(self, rows: NDArray[np.float32], wait: float, ends: float, spread: bool) -> bytes:
        """The reply over zenoh. After a lost connection the request is sent once more within its time."""
        payload = self._writer.write(rows, wait * 1e3, spread=spread)
        left = max(ends - time.monotonic(), 1e-3)
        try:
            # `_ask` waits for the whole timeout, also where a lost lane has taken a part of it.
            if wait == self._source.timeout and left > wait - _GRACE_S:
                return self._ask(payload)
            return self._source.get(self._key, payload, left + _GRACE_S)
        except ServerLost:
            if not self._source.connected_again(min(ends - time.monotonic(), _RECONNECT_S)):
                raise
        self._source.retries += 1
        left = max(ends - time.monotonic(), 1e-3)
        return self._source.get(self._key, payload, left + _GRACE_S)

    def _over_lane(
        self,
        rows: NDArray[np.float32],
        wait: float,
        ends: float,
        spread: bool,
        failed: Exception | None,
    ) -> InferResponse | None:
        """The reply over the lane; None if there is no lane, so that zenoh is to be asked.

        A request whose connection was lost is sent once more: an inference has no effect on the server.
        """
        lanes = self._source.lanes
        if lanes is None:
            return None
        lane = lanes.lane or lanes.find()
        left, reason, retried = wait, _NO_LANE, False
        while lane is not None:
            try:
                if failed is not None:
                    raise failed
                head, counts = lane.infer(self._path, rows, left, left + _GRACE_S, spread=spread)
            except (ConnectionLost, OSError) as error:
                failed = None
                lane = lanes.lost(lane, again=not getattr(error, "new", True))
                left = ends - time.monotonic()
                reason = f"the connection to the server's lane was lost: {error}"
                if retried or left <= 0:
                    raise Unavailable(f"{self._source.endpoint}: {reason}") from None
                self._source.retries += 1
                retried = True
            else:
                spreads = counts[1] if head.spread else None
                name, version = self.manifest.name, self.manifest.version
                times = head.queue_us, head.compute_us, head.batch_rows
                return InferResponse(counts[0], name, version, None, *times, spreads)
        if self._source.asked_transport == "lane":
            raise Unavailable(f"{self._source.endpoint}: {reason}")
        return None


def connect(
    endpoint: str,
    *,
    timeout: float = 5.0,
    prefix: str = PREFIX,
    shared_memory: bool = False,
    transport: Transport | None = None,
    spin_us: int = 0,
) -> RemoteSource:
    """Connect to the server at an endpoint; the arguments are `RemoteSource`'s.

    Raises:
        InvalidArgument: that is no endpoint, or no transport.
        Unavailable: nobody listens there; or the lane is asked for, and there is none.
    """
    return RemoteSource(
        endpoint,
        timeout=timeout,
        prefix=prefix,
        shared_memory=shared_memory,
        transport=transport,
        spin_us=spin_us,
    )

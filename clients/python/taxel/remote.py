"""Predictors that a Taxel server evaluates, reached over zenoh."""

import json
import time
from collections.abc import Callable
from typing import Any, Final, TypeVar

import numpy as np
import zenoh
from numpy.typing import NDArray
from pydantic import ValidationError
from typing_extensions import override

from taxel.artifacts import is_name, is_version
from taxel.errors import DeadlineExceeded, Internal, InvalidArgument, NotFound, Unavailable
from taxel.manifest import Manifest
from taxel.predictor import ModelInfo, Predictor, PredictorSource
from taxel.protocol import (
    PREFIX,
    InferResponse,
    model_key,
    pack_infer_request,
    unpack_error,
    unpack_infer_response,
    unpackb,
)

T = TypeVar("T")

_GRACE_S: Final = 0.25
"""How much longer than the server's deadline a client waits for the server to say so."""

_AS_THEY_COME: Final = zenoh.ConsolidationMode.NONE
"""There is one answer: nothing is gained by waiting for the end of answers before it is read."""


class RemoteSource(PredictorSource):
    """A connection to a server. Thread-safe; one serves any number of predictors.

    Args:
        endpoint: where the server listens, such as `tcp/127.0.0.1:7447`.
        timeout: seconds to wait for the connection, and for an answer where a call names none.
        prefix: the server's key prefix.

    Raises:
        InvalidArgument: that is no endpoint.
        Unavailable: nobody listens there.
    """

    def __init__(self, endpoint: str, *, timeout: float = 5.0, prefix: str = PREFIX) -> None:
        self.endpoint = endpoint
        self.timeout = checked_timeout(timeout)
        self.prefix = prefix
        self._session = _open(endpoint, timeout)

    @override
    def models(self) -> list[ModelInfo]:
        return self._read(
            f"{self.prefix}/v2/repository/index",
            lambda index: [ModelInfo(**model) for model in index["models"]],
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
        """What the server says at a key."""
        answer = self.get(key)
        try:
            return read(unpackb(answer))
        except (InvalidArgument, ValidationError, KeyError, TypeError) as error:
            raise Internal(f"{self.endpoint}: the answer to {key} is malformed: {error!r}") from None

    def get(self, key: str, payload: bytes | None = None, timeout: float | None = None) -> bytes:
        """One query, one answer.

        Raises:
            RequestError: the server's typed error; `Unavailable` where nobody answers,
                `DeadlineExceeded` where the answer does not come in time.
        """
        wait = self.timeout if timeout is None else timeout
        return self._answer(
            key,
            wait,
            lambda: self._session.get(key, payload=payload, timeout=wait, consolidation=_AS_THEY_COME),
        )

    def asker(self, key: str, wait: float) -> Callable[[bytes], bytes]:
        """What asks one key again and again, as `get` does but faster: zenoh is told the key once.

        Args:
            key: that is asked.
            wait: seconds to wait for each answer.

        Raises:
            Unavailable: this source was closed.
        """
        try:
            querier = self._session.declare_querier(key, timeout=wait, consolidation=_AS_THEY_COME)
        except zenoh.ZError as error:
            raise Unavailable(f"{self.endpoint}: {error}") from None
        return lambda payload: self._answer(key, wait, lambda: querier.get(payload=payload))

    def _answer(
        self, key: str, wait: float, ask: Callable[[], zenoh.handlers.Handler[zenoh.Reply]]
    ) -> bytes:
        """The one answer to a query that `ask` sends."""
        started = time.monotonic()
        try:
            reply = next(iter(ask()), None)
        except zenoh.ZError as error:
            raise Unavailable(f"{self.endpoint}: {error}") from None
        if reply is None:
            if time.monotonic() - started >= wait:
                raise DeadlineExceeded(f"{self.endpoint}: no answer to {key} within {wait:g} s")
            raise Unavailable(f"{self.endpoint}: nobody answers {key}")
        if reply.ok is not None:
            return reply.ok.payload.to_bytes()
        text = reply.err.payload.to_bytes() if reply.err is not None else b""
        if text == b"Timeout":
            raise DeadlineExceeded(f"{self.endpoint}: no answer to {key} within {wait:g} s")
        raise unpack_error(text)

    @override
    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]


class RemotePredictor(Predictor):
    """One model of a server; made by `RemoteSource.predictor`."""

    def __init__(self, source: RemoteSource, manifest: Manifest) -> None:
        super().__init__(manifest)
        self._source = source
        self._key = model_key(source.prefix, manifest.name, manifest.version, "infer")
        self._ask = source.asker(self._key, source.timeout + _GRACE_S)

    @override
    def predict(self, windows: NDArray[Any], *, timeout: float | None = None) -> NDArray[np.float32]:
        return self._infer(windows, timeout, spread=False).outputs

    @override
    def predict_with_spread(
        self, windows: NDArray[Any], *, timeout: float | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        self.check_gives_spread()
        response = self._infer(windows, timeout, spread=True)
        if response.spread is None or len(response.spread) != len(response.outputs):
            raise Internal("the server answered without the spread that was asked for")
        return response.outputs, response.spread

    def _infer(self, windows: NDArray[Any], timeout: float | None, *, spread: bool) -> InferResponse:
        wait = self._source.timeout if timeout is None else checked_timeout(timeout)
        rows = self.checked(windows)
        payload = pack_infer_request(rows, timeout_ms=wait * 1e3, spread=spread)
        if timeout is None:
            answer = self._ask(payload)
        else:
            answer = self._source.get(self._key, payload, wait + _GRACE_S)
        response = unpack_infer_response(answer)
        if len(response.outputs) != len(rows):
            raise Internal(f"the server answered {len(response.outputs)} rows to {len(rows)} windows")
        return response


def connect(endpoint: str, *, timeout: float = 5.0, prefix: str = PREFIX) -> RemoteSource:
    """Connect to the server at an endpoint; the arguments are `RemoteSource`'s.

    Raises:
        InvalidArgument: that is no endpoint.
        Unavailable: nobody listens there.
    """
    return RemoteSource(endpoint, timeout=timeout, prefix=prefix)


def checked_timeout(timeout: float) -> float:
    """A timeout in seconds.

    Raises:
        InvalidArgument: it is not a positive, finite number.
    """
    if not (np.isfinite(timeout) and timeout > 0):
        raise InvalidArgument(f"timeout is {timeout!r}: expected seconds above 0")
    return timeout


def _open(endpoint: str, timeout: float) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/timeout_ms", str(round(timeout * 1e3)))
    config.insert_json5("connect/exit_on_failure", "true")
    try:
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    except zenoh.ZError:
        raise InvalidArgument(
            f"endpoint {endpoint!r}: expected PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447"
        ) from None
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        # What follows ' at /' is where zenoh was built.
        reason = str(error).partition(" at /")[0]
        raise Unavailable(f"no server at {endpoint} within {timeout:g} s: {reason}") from None

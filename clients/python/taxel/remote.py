"""Predictors that a Taxel server evaluates, reached over zenoh."""

from collections.abc import Callable
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from typing_extensions import override

from taxel.artifacts import is_name, is_version
from taxel.envelopes import RequestWriter
from taxel.errors import Internal, InvalidArgument, NotFound, Unavailable
from taxel.manifest import Manifest
from taxel.predictor import ModelInfo, Predictor, PredictorSource
from taxel.protocol import (
    PREFIX,
    InferResponse,
    model_key,
    unpack_infer_response,
    unpackb,
)
from taxel.remote_connection import Connection, checked_timeout

T = TypeVar("T")

_GRACE_S: Final = 0.25
"""How much longer a client waits than the server's deadline: time for the server's refusal."""


class RemoteSource(Connection, PredictorSource):
    """A connection to a server. Thread-safe; one serves any number of predictors.

    Args:
        endpoint: where the server listens, such as `tcp/127.0.0.1:7447`.
        timeout: seconds to wait for the connection, and for an answer if a call gives no timeout.
        prefix: the server's key prefix.
        shared_memory: whether large requests go through shared memory, where the server allows it.

    Raises:
        InvalidArgument: that is no endpoint.
        Unavailable: nobody listens there.
    """

    def __init__(
        self, endpoint: str, *, timeout: float = 5.0, prefix: str = PREFIX, shared_memory: bool = False
    ) -> None:
        super().__init__(endpoint, timeout, shared_memory=shared_memory)
        self.prefix = prefix

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
        self._key = model_key(source.prefix, manifest.name, manifest.version, "infer")
        self._ask = source.asker(self._key, source.timeout + _GRACE_S)

    @override
    def predict(self, windows: NDArray[Any], *, timeout: float | None = None) -> NDArray[np.float32]:
        return self.infer(windows, timeout=timeout).outputs

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
        rows = self.checked(windows)
        payload = self._writer.write(rows, wait * 1e3, spread=spread)
        if timeout is None:
            answer = self._ask(payload)
        else:
            answer = self._source.get(self._key, payload, wait + _GRACE_S)
        response = unpack_infer_response(answer)
        if len(response.outputs) != len(rows):
            raise Internal(f"the server answered {len(response.outputs)} rows to {len(rows)} windows")
        return response


def connect(
    endpoint: str, *, timeout: float = 5.0, prefix: str = PREFIX, shared_memory: bool = False
) -> RemoteSource:
    """Connect to the server at an endpoint; the arguments are `RemoteSource`'s.

    Raises:
        InvalidArgument: that is no endpoint.
        Unavailable: nobody listens there.
    """
    return RemoteSource(endpoint, timeout=timeout, prefix=prefix, shared_memory=shared_memory)

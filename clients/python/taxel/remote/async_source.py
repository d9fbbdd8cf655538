"""The asynchronous face: calls are awaited, in one event loop."""

import asyncio
import time
from collections.abc import Generator, Sequence
from types import TracebackType
from typing import Any, Literal, NoReturn, Self, overload

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from taxel.arguments import checked_flag
from taxel.errors import InvalidArgument, Unavailable
from taxel.lane.async_client import AsyncLane
from taxel.lane.connection import ConnectionLost
from taxel.lane.repeated_request import RepeatedRequest
from taxel.predictor import DEFAULT_MODEL, NOT_PICKLED, BasePredictor, ModelInfo, Timing
from taxel.protocol import PREFIX, InferResponse
from taxel.remote.awaited_calls import AwaitedCalls
from taxel.remote.core import NO_LANE, REPEATED_ROWS, RemoteCore, TransportName, with_grace
from taxel.remote.credentials import Credentials
from taxel.remote.options import ConnectOptions, Transport, lane_of, open_transport
from taxel.remote.query_transport import QueryTransport
from taxel.remote.remote_model import RemoteModel, timing_of


class AsyncSource:
    """A connection to a server, for one event loop. It is opened by `async with`, or by awaiting it.

    The arguments and errors are those of `connect_async`. Any number of calls may be in flight. A call that
    is cancelled leaves nothing behind: its late answer is dropped.
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
    ) -> None:
        self._options = ConnectOptions.checked(
            endpoint, timeout, prefix, shared_memory, credentials, transport
        )
        self._opened: RemoteCore[AsyncLane] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self.endpoint = self._options.endpoint

    async def open(self) -> Self:
        """Connect, unless it is open already.

        Raises:
            PermissionDenied: the server turns this client away, or its certificate is not trusted.
            Unavailable: nobody listens there; or the lane is asked for, and there is none.
        """
        if self._opened is None:
            self._loop = asyncio.get_running_loop()
            # zenoh waits for the connection in the calling thread.
            connection = await asyncio.to_thread(open_transport, self._options)
            options = self._options
            self._opened = RemoteCore(
                AwaitedCalls(self._loop),
                connection,
                options.prefix,
                options.timeout,
                lane_of(options, connection),
            )
            try:
                await self._opened.find_lane(self._loop.time() + options.timeout)
                if options.lane == "only" and self.transport != "lane":
                    raise Unavailable(f"{self.endpoint}: {NO_LANE}")
            except BaseException:
                await self.close()
                raise
        return self

    async def close(self) -> None:
        """End all connections. Calls in flight, and later ones, raise `Unavailable`."""
        if self._opened is not None:
            self._opened.close()
            if self._options.transport is None:
                await asyncio.to_thread(self._opened.transport.close)

    @property
    def core(self) -> RemoteCore[AsyncLane]:
        """What the running event loop may ask.

        Raises:
            Unavailable: it is not open, or was opened in another event loop.
        """
        if self._opened is None:
            raise Unavailable(f"{self.endpoint}: this source is not open: expected `async with` or `await`")
        if asyncio.get_running_loop() is not self._loop:
            self._opened.check_usable()
            raise Unavailable(
                f"{self.endpoint}: this source was opened in another event loop: connect in each loop"
            )
        return self._opened

    @property
    def transport(self) -> TransportName:
        """How windows reach the server, as far as it is known."""
        return self.core.transport_name

    @property
    def retries(self) -> int:
        """How often a request was sent again to the same server or to another."""
        return self.core.retries

    async def models(self) -> list[ModelInfo]:
        """Every version of every model, sorted."""
        return await self.core.models()

    async def predictor(self, name: str = DEFAULT_MODEL, version: str | None = None) -> "AsyncPredictor":
        """A predictor for a model, its newest version if none is named.

        Without a name, it is the causal model that comes with Taxel.

        Raises:
            NotFound: there is no such model or version.
        """
        return AsyncPredictor(self, await self.core.model(name, version))

    async def ready(self) -> bool:
        """Whether the server is ready to predict; False also where nobody answers."""
        return await self.core.ready()

    async def get(self, key: str, payload: bytes | None = None, timeout: float | None = None) -> bytes:
        """As `RemoteSource.get`."""
        return await self.core.get(key, payload, timeout)

    def __await__(self) -> Generator[Any, None, Self]:
        return self.open().__await__()

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()

    @override
    def __reduce__(self) -> NoReturn:
        raise InvalidArgument(NOT_PICKLED.format(type(self).__name__))


class AsyncPredictor(BasePredictor):
    """One model of a server; made by `AsyncSource.predictor`."""

    def __init__(self, source: AsyncSource, model: RemoteModel) -> None:
        super().__init__(model.manifest)
        self._source = source
        self._model = model
        self._repeated: dict[tuple[int, ...], RepeatedRequest] = {}
        """Requests of few windows, by their shape."""

    @property
    def transport(self) -> TransportName:
        """How windows reach the server, as far as it is known."""
        return self._source.transport

    @overload
    async def predict(
        self,
        windows: NDArray[Any],
        *,
        timeout: float | None = None,
        timing: Literal[False] = False,
        traceparent: str | None = None,
    ) -> NDArray[np.float32]: ...

    @overload
    async def predict(
        self,
        windows: NDArray[Any],
        *,
        timeout: float | None = None,
        timing: Literal[True],
        traceparent: str | None = None,
    ) -> tuple[NDArray[np.float32], Timing]: ...

    async def predict(
        self,
        windows: NDArray[Any],
        *,
        timeout: float | None = None,
        timing: bool = False,
        traceparent: str | None = None,
    ) -> NDArray[np.float32] | tuple[NDArray[np.float32], Timing]:
        """As `RemotePredictor.predict`."""
        core = self._source.core
        lanes = core.lanes
        lane = lanes.lane if lanes is not None else None
        if lane is not None and timeout is None and timing is False and traceparent is None:
            repeated = self._repeated.get(getattr(windows, "shape", ()))
            if repeated is not None and repeated.takes(windows):
                core.check_usable()
                began = time.monotonic()
                try:
                    return await lane.repeat(repeated, windows)
                except (ConnectionLost, OSError) as error:
                    failed = error, began
                rows = self.checked(windows)
                return (await core.infer(self._model, rows, None, False, failed=failed)).outputs
        reply = await core.infer(
            self._model, self.checked(windows), timeout, False, traceparent=traceparent
        )
        if lane is not None and timeout is None and len(reply.outputs) <= REPEATED_ROWS:
            shape, wait = (len(reply.outputs), len(self._features)), core.timeout
            self._repeated[shape] = RepeatedRequest(self._model.path, shape, wait, with_grace(wait))
        return (reply.outputs, timing_of(reply)) if checked_flag("timing", timing) else reply.outputs

    async def predict_base(
        self, windows: NDArray[Any], *, timeout: float | None = None
    ) -> NDArray[np.float32]:
        """As `Predictor.predict_base`."""
        self._model.check_gives_base()
        return await self.predict(windows, timeout=timeout)

    async def predict_with_spread(
        self, windows: NDArray[Any], *, timeout: float | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """As `Predictor.predict_with_spread`."""
        reply = await self.infer(windows, timeout=timeout, spread=True)
        assert reply.spread is not None
        return reply.outputs, reply.spread

    async def infer(
        self,
        windows: NDArray[Any],
        *,
        timeout: float | None = None,
        spread: bool = False,
        traceparent: str | None = None,
    ) -> InferResponse:
        """As `RemotePredictor.infer`."""
        if spread:
            self.check_gives_spread()
        return await self._source.core.infer(
            self._model, self.checked(windows), timeout, spread, traceparent=traceparent
        )


def connect_async(
    endpoint: str | Sequence[str] | None = None,
    *,
    timeout: float = 5.0,
    prefix: str = PREFIX,
    shared_memory: bool = False,
    credentials: Credentials | None = None,
    transport: Transport | QueryTransport | None = None,
) -> AsyncSource:
    """Connect to the server at an endpoint, for an event loop.

        async with taxel.connect_async("tcp/127.0.0.1:7447") as server:
            predictor = await server.predictor("xgb")
            channels = await predictor.predict(windows)

    Nothing is opened before `async with` or `await`. The arguments are those of `taxel.connect`.

    Raises:
        InvalidArgument: an argument is wrong; the text names it.
    """
    return AsyncSource(
        endpoint,
        timeout=timeout,
        prefix=prefix,
        shared_memory=shared_memory,
        credentials=credentials,
        transport=transport,
    )

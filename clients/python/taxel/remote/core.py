"""What a remote source does, whichever face it has: the way that a request takes, and what follows a loss.

Everything that waits goes through `Waiting`, so that both faces take the same steps.
"""

import os
import time
from collections.abc import Callable
from typing import Any, Final, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from taxel.arguments import checked_flag, checked_timeout, checked_version
from taxel.artifacts import is_name, is_version
from taxel.errors import (
    Internal,
    InvalidArgument,
    NotFound,
    PermissionDenied,
    RequestError,
    ServerLost,
    Unavailable,
)
from taxel.lane.connection import ConnectionLost
from taxel.lane.lookup import LaneLookup, LaneT
from taxel.lane.offer import LaneOffer, machine_identity
from taxel.predictor import ModelInfo
from taxel.protocol import InferResponse, model_key, unpack_infer_response, unpackb
from taxel.remote.failover import Failover
from taxel.remote.query_transport import QueryTransport
from taxel.remote.remote_model import RemoteModel
from taxel.remote.replicas import Replicas
from taxel.remote.waiting import Waiting
from taxel.trace_context import TRACE_CONTEXT, checked_traceparent
from taxel.zenoh_process import AFTER_FORK

T = TypeVar("T")

TransportName = Literal["zenoh", "lane", "memory"]
"""How windows reach a server. Over a lane, metadata still come over zenoh."""

NO_LANE: Final = (
    "no lane: expected a server of this user on this machine that runs without --lane off; "
    "without transport='lane', zenoh is asked"
)

_GRACE_SHARE: Final = 0.25
_GRACE_S: Final = 0.25
"""A client waits longer than the server's deadline, for the server's refusal: this share of the timeout,
and so many seconds at most."""

REPEATED_ROWS: Final = 64
"""The most windows in a request whose other bytes are kept."""

_LOOKUP_S: Final = 1.0
"""The longest that the server's metadata are waited for, to find its lane."""

_RECONNECT_S: Final = 2.0
"""How long after its first loss of the connection a call goes on. The next connection may be lost, too."""

_LOOK_AGAIN_S: Final = 0.01
_DECLARED_S: Final = 0.05
"""How soon after a connection, or an end, the server's keys are known to be there, or to be gone."""


def with_grace(timeout: float) -> float:
    """Seconds that a client waits for an answer, if the server has `timeout` seconds for it."""
    return timeout + min(_GRACE_SHARE * timeout, _GRACE_S)


class RemoteCore(Generic[LaneT]):
    """One connection to a server.

    Args:
        waiting: how calls wait.
        transport: carries metadata, and requests that take no lane.
        prefix: the server's key prefix.
        timeout: seconds to wait for an answer if a call gives no timeout.
        lane: whether to look for a lane; `only` if requests may go no other way.
    """

    def __init__(
        self,
        waiting: Waiting[LaneT],
        transport: QueryTransport,
        prefix: str,
        timeout: float,
        lane: Literal["no", "yes", "only"],
    ) -> None:
        self.transport = transport
        self.prefix = prefix
        self.timeout = timeout
        self.lanes: LaneLookup[LaneT] | None = None if lane == "no" else LaneLookup()
        self._waiting = waiting
        self._repeated = 0
        self._failover = Failover(transport) if isinstance(transport, Replicas) else None
        self._lane_only = lane == "only"
        self._process = os.getpid()
        self._closed = False

    @property
    def retries(self) -> int:
        """How often a request was sent again, to the same server or to another."""
        return self._repeated + (self._failover.repeated if self._failover else 0)

    @property
    def transport_name(self) -> TransportName:
        """How requests reach the server, as far as it is known."""
        if self.lanes is not None and self.lanes.lane is not None:
            return "lane"
        return self.transport.name

    def check_usable(self) -> None:
        """Raise if it cannot be asked from here.

        Raises:
            Unavailable: it was closed, or opened before this process was forked.
        """
        if self._process != os.getpid():
            raise Unavailable(
                f"{self.transport.endpoint}: process {self._process} opened this source before it forked "
                f"this process: {AFTER_FORK}"
            )
        if self._closed:
            raise Unavailable(f"{self.transport.endpoint}: this source was closed")

    def close(self) -> None:
        """Close the lane, and refuse later calls. The transport is the caller's to close."""
        self._closed = True
        # A forked process shares the event loop's selector with its parent, which still uses the lane.
        if self.lanes is not None and self._process == os.getpid():
            self.lanes.close()

    async def get(self, key: str, payload: bytes | None = None, timeout: float | None = None) -> bytes:
        """One query, one answer.

        Raises:
            RequestError: as `QueryTransport.start` says.
        """
        self.check_usable()
        if not isinstance(key, str) or not isinstance(payload, (bytes, type(None))):
            raise InvalidArgument(f"key {key!r}, payload {payload!r}: expected text, and bytes or None")
        wait = self.timeout if timeout is None else checked_timeout(timeout)
        return await self._ask(key, payload, wait)

    async def models(self) -> list[ModelInfo]:
        """Every version of every model."""
        return await self._read(
            f"{self.prefix}/v2/repository/index",
            lambda index: [ModelInfo.read(model) for model in index["models"]],
        )

    async def model(self, name: str, version: str | None) -> RemoteModel:
        """What a predictor needs.

        Raises:
            NotFound: there is no such model or version.
            InvalidArgument: the version is no text.
        """
        checked_version(version)
        if not is_name(name) or not (version is None or is_version(version)):
            raise NotFound(f"no model can be called {name!r}, version {version!r}")
        model = await self._read(
            model_key(self.prefix, name, version),
            lambda described: RemoteModel.read(described["parameters"], self.prefix),
        )
        self.transport.prepare(model.key, with_grace(self.timeout))
        return model

    async def ready(self) -> bool:
        """Whether the server is ready to predict; False also where nobody answers."""
        try:
            return await self._read(f"{self.prefix}/v2/health/ready", lambda health: bool(health["ready"]))
        except Unavailable:
            return False

    async def infer(
        self,
        model: RemoteModel,
        rows: NDArray[np.float32],
        timeout: float | None,
        spread: bool,
        *,
        traceparent: str | None = None,
        failed: tuple[Exception, float] | None = None,
    ) -> InferResponse:
        """The server's whole reply to windows that were checked.

        Args:
            model: that is asked.
            rows: the windows.
            timeout: as in `Predictor.predict`.
            spread: whether the spread is asked for.
            traceparent: the W3C's, of the trace that the call belongs to.
            failed: how the lane failed at these windows, and when it was asked.
        """
        self.check_usable()
        checked_flag("spread", spread)
        if traceparent is not None:
            checked_traceparent(traceparent)
        wait = self.timeout if timeout is None else checked_timeout(timeout)
        error, began = failed or (None, time.monotonic())
        ends = began + wait
        reply = None
        if self.lanes is not None:
            reply = await self._over_lane(self.lanes, model, rows, ends, wait, spread, traceparent, error)
        if reply is None:
            payload = model.writer.write(rows, wait * 1e3, spread=spread, traceparent=traceparent)
            reply = unpack_infer_response(await self._over_transport(model, payload, ends, wait))
        if len(reply.outputs) != len(rows):
            raise Internal(f"the server answered {len(reply.outputs)} rows to {len(rows)} windows")
        if spread and reply.spread is None:
            raise Internal("the server answered without the spread that was asked for")
        return reply

    async def _over_transport(self, model: RemoteModel, payload: bytes, ends: float, wait: float) -> bytes:
        """The reply. A request whose connection is lost is sent again, for a while after the first loss."""
        left = ends - time.monotonic()
        # What was prepared has the whole timeout; only a lost lane takes a notable part of it.
        left = wait if with_grace(left) > wait else max(left, 1e-3)
        lost_until: float | None = None
        while True:
            try:
                return await self._ask(model.key, payload, with_grace(left), model.cancel_key)
            except ServerLost:
                lost_until = lost_until or min(ends, time.monotonic() + _RECONNECT_S)
                if not await self._connected_again(lost_until):
                    raise
            self._repeated += 1
            left = max(ends - time.monotonic(), 1e-3)

    async def _over_lane(
        self,
        lanes: LaneLookup[LaneT],
        model: RemoteModel,
        rows: NDArray[np.float32],
        ends: float,
        wait: float,
        spread: bool,
        traceparent: str | None,
        failed: Exception | None,
    ) -> InferResponse | None:
        """The reply over the lane; None if there is no lane, so that the transport is to be asked.

        A request whose connection was lost is sent once more: an inference has no effect on the server.
        """
        lane = lanes.lane or await self.find_lane(ends)
        left, reason, retried = wait, NO_LANE, False
        while lane is not None:
            try:
                if failed is not None:
                    raise failed
                told = traceparent if TRACE_CONTEXT in lane.extensions else None
                head, counts = await self._waiting.ask_lane(
                    lane, model.path, rows, left, with_grace(left), spread, told
                )
            except (ConnectionLost, OSError) as error:
                failed = None
                self.check_usable()
                again = not getattr(error, "new", True)
                lane = await self._lane_again(lanes, lane, ends, again=again)
                left = ends - time.monotonic()
                reason = f"the connection to the server's lane was lost: {error}"
                if retried or left <= 0:
                    raise ServerLost(f"{self.transport.endpoint}: {reason}") from None
                self._repeated += 1
                retried = True
            else:
                spreads = counts[1] if head.spread else None
                name, version = model.manifest.name, model.manifest.version
                times = head.queue_us, head.compute_us, head.batch_rows
                return InferResponse(counts[0], name, version, None, *times, spreads)
        if self._lane_only:
            kind = ServerLost if retried else Unavailable
            raise kind(f"{self.transport.endpoint}: {reason}")
        return None

    async def find_lane(self, ends: float) -> LaneT | None:
        """The lane; None if there is none that this client can take, or if it is not time to look.

        Args:
            ends: when the call has to be over. A look takes at most half of the time until then.
        """
        lanes = self.lanes
        if lanes is None:
            return None
        if lanes.begin():
            lane, there_is_none = None, False
            try:
                within = min((ends - time.monotonic()) / 2, _LOOKUP_S)
                told = await self._waiting.ask(self.transport, f"{self.prefix}/v2", None, max(within, 1e-3))
                offer = LaneOffer.read(unpackb(told))
                there_is_none = True
                if offer is not None and offer.machine == machine_identity():
                    lane = await self._waiting.open_lane(offer.address, offer.extensions)
                    there_is_none = False
            except (RequestError, OSError, ValueError):
                # Whatever is wrong with the lane, zenoh remains.
                pass
            finally:
                lanes.end(lane, there_is_none=there_is_none)
            return lane
        return await self._found_by_others(lanes, ends)

    async def _lane_again(
        self, lanes: LaneLookup[LaneT], lost: LaneT, ends: float, *, again: bool
    ) -> LaneT | None:
        """The lane that replaces a lost one, opened at once if `again`; None if there is none now."""
        if not lanes.lost(lost):
            return await self._found_by_others(lanes, ends)
        lane = None
        try:
            if again:
                lane = await self._waiting.open_lane(lost.address, lost.extensions)
        except OSError:
            pass
        finally:
            lanes.end(lane)
        return lane

    async def _found_by_others(self, lanes: LaneLookup[LaneT], ends: float) -> LaneT | None:
        """The lane, once another call has finished looking for it."""
        while lanes.looking and time.monotonic() < ends:
            await self._waiting.sleep(_LOOK_AGAIN_S)
        return lanes.lane

    async def _ask(
        self, key: str, payload: bytes | None, timeout: float, cancel_key: str | None = None
    ) -> bytes:
        if self._failover is not None:
            return await self._failover.ask(self._waiting, key, payload, timeout, cancel_key)
        try:
            return await self._waiting.ask(self.transport, key, payload, timeout, cancel_key)
        except PermissionDenied:
            # A new server's keys become known one after the other, and one that ends is known for a moment
            # longer. So the answer counts that comes a little later.
            await self._waiting.sleep(_DECLARED_S)
            return await self._waiting.ask(self.transport, key, payload, timeout, cancel_key)

    async def _connected_again(self, ends: float) -> bool:
        """Wait until the transport has connected again after `ServerLost`; whether it has in time."""
        while ends - time.monotonic() > _DECLARED_S:
            if self.transport.connected:
                # The server's key becomes known just after the connection.
                await self._waiting.sleep(_DECLARED_S)
                return True
            await self._waiting.sleep(_LOOK_AGAIN_S)
        return False

    async def _read(self, key: str, read: Callable[[Any], T]) -> T:
        """The server's answer at a key."""
        answer = await self.get(key)
        try:
            return read(unpackb(answer))
        except (InvalidArgument, ValidationError, KeyError, TypeError) as error:
            raise Internal(
                f"{self.transport.endpoint}: the answer to {key} is malformed: {error!r}"
            ) from None

"""A server: the core, and the transports that bring it requests."""

from typing import Self

from taxel.errors import TaxelError
from taxel.lane.offer import LaneOffer
from taxel_server.core.core import Core
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
from taxel_server.transports.lane_transport import LaneTransport
from taxel_server.transports.zenoh_transport import ZenohTransport


class Service:
    """An engine, served from `start` until `close`. Constructing it opens nothing.

    Args:
        engine: its models are loaded and warmed up.
        options: where to listen, and the limits.
    """

    def __init__(self, engine: Engine, options: ServerOptions) -> None:
        self._core = Core(engine, options)
        self._zenoh = ZenohTransport(self._core, options)
        self._lane = LaneTransport(self._core, options)

    @property
    def queued_rows(self) -> int:
        """Windows accepted and not yet answered."""
        return self._core.queued_rows

    @property
    def lane(self) -> LaneOffer | None:
        """Where clients on this machine may ask, too; None if there is no lane."""
        return self._core.lane

    def start(self) -> Self:
        """Listen and answer.

        Raises:
            SettingsError: an endpoint is malformed.
            TaxelError: an endpoint is occupied.
        """
        self._zenoh.listen()
        try:
            self._core.lane = self._lane.listen()
        except TaxelError:
            self._zenoh.hang_up()
            raise
        self._core.start()
        self._lane.start()
        self._zenoh.start()
        self._core.ready = True
        return self

    def close(self) -> bool:
        """Stop: accept no more requests, answer the queued ones, and close the session.

        Requests that are not finished within `drain_seconds` are answered with `Unavailable`, and so are
        requests that arrive meanwhile.

        Returns:
            False if a client that has stopped reading kept the session open.
        """
        self._core.drain()
        self._lane.close()
        return self._zenoh.close()

    def abandon(self) -> None:
        """Answer all open requests with `Unavailable`; for use if `close` takes too long."""
        self._core.abandon()

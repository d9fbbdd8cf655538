"""A server: the core, and the transports that bring it requests."""

from typing import Self

from taxel_server.core.core import Core
from taxel_server.engine import Engine
from taxel_server.options import ServerOptions
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

    @property
    def queued_rows(self) -> int:
        """Windows accepted and not yet answered."""
        return self._core.queued_rows

    def start(self) -> Self:
        """Listen and answer.

        Raises:
            SettingsError: an endpoint is malformed.
            TaxelError: an endpoint is occupied.
        """
        self._zenoh.listen()
        self._core.start()
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
        return self._zenoh.close()

    def abandon(self) -> None:
        """Answer all open requests with `Unavailable`; for use if `close` takes too long."""
        self._core.abandon()

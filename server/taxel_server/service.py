"""A server: the core, and the transports that bring it requests."""

from typing import TYPE_CHECKING, Self

from taxel.dependencies import require
from taxel.errors import TaxelError
from taxel.lane.offer import LaneOffer
from taxel_server.core.administration import Administration
from taxel_server.core.core import Core
from taxel_server.engine import Engine
from taxel_server.loading.loader import Loader
from taxel_server.operations.liveness import Liveness
from taxel_server.options import ServerOptions
from taxel_server.transports.lane_transport import LaneTransport
from taxel_server.transports.zenoh_transport import ZenohTransport

if TYPE_CHECKING:
    from taxel_server.operations.http_endpoint import HttpEndpoint
    from taxel_server.transports.web_socket import WebSocketTransport


class Service:
    """An engine, served from `start` until `close`. Constructing it opens nothing.

    Args:
        engine: its models are loaded and warmed up.
        options: where to listen, and the limits.
        loader: loads further models while the server runs, if there is one.
    """

    def __init__(self, engine: Engine, options: ServerOptions, loader: Loader | None = None) -> None:
        self._core = Core(engine, options)
        self._loader = loader
        exchange = loader.exchange if loader is not None else None
        self._core.take_order = Administration(engine, exchange, options.admin).take
        self._liveness = Liveness(lambda: self._core.progress)
        self._http: HttpEndpoint | None = None
        self._web_socket: WebSocketTransport | None = None
        self._options = options
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

    @property
    def http(self) -> str | None:
        """Where metrics and health are told over HTTP, as HOST:PORT; None if nowhere."""
        return self._http.address if self._http else None

    @property
    def websocket(self) -> str | None:
        """Where web pages may ask, as `ws://HOST:PORT/`; None if nowhere."""
        return self._web_socket.address if self._web_socket else None

    @property
    def is_live(self) -> bool:
        """Whether the server makes progress."""
        return self._liveness.is_live()

    def start(self) -> Self:
        """Listen and answer.

        Raises:
            SettingsError: an endpoint is malformed.
            MissingDependency: the package for WebSockets is missing.
            TaxelError: an endpoint is occupied.
        """
        self._zenoh.listen()
        try:
            self._http = self._listen_for_http()
            self._core.lane = self._lane.listen()
            self._web_socket = self._listen_for_pages()
        except TaxelError:
            if self._http is not None:
                self._http.close()
            self._lane.close()
            self._zenoh.hang_up()
            raise
        if self._loader is not None:
            self._core.statistics.loads = self._loader.counts
            self._loader.watch(self._core.refresh_routes)
        self._core.start()
        self._lane.start()
        if self._web_socket is not None:
            self._web_socket.start()
        self._zenoh.start()
        self._core.ready = True
        if self._http is not None:
            self._http.start()
        return self

    def _listen_for_http(self) -> "HttpEndpoint | None":
        if self._options.http == "off":
            return None
        from taxel_server.operations.http_endpoint import HttpEndpoint
        from taxel_server.operations.metrics import registry_of

        core = self._core
        registry = registry_of(core.statistics.read, lambda: core.ready)
        return HttpEndpoint(self._options.http, registry, self._liveness.is_live, lambda: core.ready)

    def _listen_for_pages(self) -> "WebSocketTransport | None":
        if self._options.websocket == "off":
            return None
        require("a WebSocket for web pages", "watch", "websockets")
        from taxel_server.transports.web_socket import WebSocketTransport

        if self._core.lane is None:
            raise TaxelError("websocket: there is no lane to pass requests to; the log says why")
        origins = self._options.websocket_origins
        return WebSocketTransport(self._options.websocket, origins, self._core.lane.address)

    def close(self) -> bool:
        """Stop: accept no more requests, answer the queued ones, and close the session.

        Requests that are not finished within `drain_seconds` are answered with `Unavailable`, and so are
        requests that arrive meanwhile.

        Returns:
            False if a client that has stopped reading kept the session open.
        """
        if self._loader is not None:
            self._loader.close()
        self._zenoh.withdraw()
        self._core.drain()
        if self._http is not None:
            self._http.close()
        if self._web_socket is not None:
            self._web_socket.close()
        self._lane.close()
        return self._zenoh.close()

    def abandon(self) -> None:
        """Answer all open requests with `Unavailable`; for use if `close` takes too long."""
        self._core.abandon()

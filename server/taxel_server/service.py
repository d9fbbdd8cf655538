"""The zenoh service: hands inference to the batcher, and every other query to the metadata thread.

zenoh's network threads put queries into a channel, so they never wait for Python. One thread, the
receiver, takes each query out. It gives an inference query to the batcher, whose worker decodes,
evaluates and answers it. It gives every other query to the metadata thread, so that a busy server
still tells its health and refuses at once. The receiver itself answers a single window that finds
the server idle.
"""

import logging
from collections.abc import Callable
from threading import Thread
from typing import Final

import zenoh
from typing_extensions import override
from zenoh.handlers import FifoChannel, Handler

from taxel.errors import Internal, RequestError
from taxel.protocol import InferRequest, InferResponse, model_key, pack_infer_response
from taxel_server.batcher import Batcher
from taxel_server.engine import Engine, LoadedModel
from taxel_server.envelopes import RequestReader
from taxel_server.jobs import Job
from taxel_server.metadata import ServerMetadata
from taxel_server.metadata_thread import MetadataThread, reply
from taxel_server.options import ServerOptions
from taxel_server.session import open_session

_LOG: Final = logging.getLogger(__name__)

_NOTHING: Final = zenoh.ZBytes(b"")

_CHANNEL: Final = 16384
"""The most queries in the channel; if it is full, clients wait to send."""

_FAREWELL_S: Final = 0.2
"""How long closing waits for clients that have stopped reading."""


class QueryJob(Job):
    """An inference query."""

    def __init__(
        self,
        query: zenoh.Query,
        payload: zenoh.ZBytes,
        model: LoadedModel,
        rows: int,
        reader: RequestReader,
    ) -> None:
        super().__init__(model, rows)
        self._query = query
        self._payload = payload
        self._reader = reader

    @override
    def decode(self) -> InferRequest:
        return self._reader.read(self._payload.to_bytes())

    @override
    def answer(self, result: InferResponse | RequestError) -> None:
        reply(self._query, result if isinstance(result, RequestError) else pack_infer_response(result))


class Service:
    """An engine, served over zenoh from construction until `close`.

    Args:
        engine: its models are loaded and warmed up.
        options: where to listen, and the limits.

    Raises:
        SettingsError: an endpoint is malformed.
        TaxelError: an endpoint is occupied.
    """

    def __init__(self, engine: Engine, options: ServerOptions) -> None:
        self._options = options
        self._ready = False
        self._reader = RequestReader(options.max_request_rows)
        self._routes = _infer_routes(engine, options.prefix)
        self._session = open_session(options.listen, shared_memory=options.shared_memory)
        self._batcher = Batcher(
            max_batch_rows=options.max_batch_rows,
            max_queue_rows=options.max_queue_rows,
            max_queue_requests=options.max_queue_requests,
        )
        metadata = ServerMetadata(engine, lambda: self._ready, self._batcher.statistics)
        self._metadata_thread = MetadataThread(
            lambda key: metadata.answer(key.removeprefix(f"{options.prefix}/"))
        )
        # One queryable for all keys: two that overlap would both answer a query.
        # With `complete`, one replica answers each query; by default all would.
        self._queryable = self._session.declare_queryable(
            f"{options.prefix}/**", FifoChannel(_CHANNEL), complete=True
        )
        self._receiver = Thread(
            target=self._receive, args=(self._queryable.handler,), name="taxel-receiver", daemon=True
        )
        self._receiver.start()
        self._ready = True

    @property
    def queued_rows(self) -> int:
        """Windows accepted and not yet answered."""
        return self._batcher.queued_rows

    def close(self) -> bool:
        """Stop: accept no more requests, answer the queued ones, and close the session.

        Requests that are not finished within `drain_seconds` are answered with `Unavailable`, and so are
        requests that arrive meanwhile.

        Returns:
            False if a client that has stopped reading kept the session open.
        """
        self._batcher.stop(self._options.drain_seconds)
        self._ready = False
        self._batcher.join()
        self._queryable.undeclare()  # type: ignore[no-untyped-call]
        self._receiver.join()
        self._metadata_thread.close()
        # zenoh waits ten seconds and more for a client that has stopped reading.
        farewell = Thread(target=self._session.close, name="taxel-farewell", daemon=True)
        farewell.start()
        farewell.join(_FAREWELL_S)
        return not farewell.is_alive()

    def abandon(self) -> None:
        """Answer all open requests with `Unavailable`; for use if `close` takes too long."""
        self._batcher.abandon()

    def _receive(self, channel: Handler[zenoh.Query]) -> None:
        """Pass queries on until the channel is closed and empty."""
        while (query := _taken(channel.recv)) is not None:
            following = _taken(channel.try_recv)
            self._hand_on(query, self._batcher.run if following is None else self._batcher.submit)
            while following is not None:
                self._hand_on(following, self._batcher.submit)
                following = _taken(channel.try_recv)

    def _hand_on(self, query: zenoh.Query, infer: Callable[[Job], None]) -> None:
        """Give a query to the batcher or to the metadata thread."""
        try:
            self._route(query, infer)
        except Exception:
            # The receiver must survive a query that cannot be passed on.
            _LOG.exception("a query could not be handed on")
            self._metadata_thread.take(query, Internal("the query failed: the server's log says more"))

    def _route(self, query: zenoh.Query, infer: Callable[[Job], None]) -> None:
        model = self._routes.get(str(query.key_expr))
        if model is None:
            self._metadata_thread.take(query)
            return
        payload = query.payload or _NOTHING
        try:
            rows = self._reader.rows_in(len(payload), len(model.manifest.window.features))
            infer(QueryJob(query, payload, model, rows, self._reader))
        except RequestError as error:
            _LOG.debug("%s: %s: %s", model.label, error.code, error)
            self._metadata_thread.take(query, error)


def _taken(take: Callable[[], zenoh.Query | None]) -> zenoh.Query | None:
    """The next query of a channel; None if there is none, or if the channel is closed."""
    try:
        return take()
    except zenoh.ZError:
        return None


def _infer_routes(engine: Engine, prefix: str) -> dict[str, LoadedModel]:
    """Every key of an inference request, and its model."""
    routes: dict[str, LoadedModel] = {}
    for loaded in engine.load_all():
        name, version = loaded.manifest.name, loaded.manifest.version
        routes[model_key(prefix, name, version, "infer")] = loaded
        routes[model_key(prefix, name, None, "infer")] = engine.model(name)
    return routes

"""The zenoh transport: inference goes to the core's batcher, and every other query to the metadata thread.

zenoh's network threads put queries into a channel, so they never wait for Python. One thread, the
receiver, takes each query out. It gives an inference query to the core, whose worker decodes,
evaluates and answers it. It gives every other query to the metadata thread, so that a busy server
still tells its health and refuses at once. The receiver itself answers a single window that finds
the server idle. The server's own keys, which clients of several servers ask, have a channel and a
receiver of their own.
"""

import logging
import time
from collections.abc import Callable
from threading import Thread
from typing import Final

import zenoh
from typing_extensions import override
from zenoh.handlers import FifoChannel, Handler

from taxel.envelopes import RequestReader
from taxel.errors import Internal, RequestError, ResourceExhausted
from taxel.protocol import CANCEL_PATH, REPLICAS, InferRequest, InferResponse, pack_infer_response, packb
from taxel.zenoh_process import close_session
from taxel_server.core.core import Core
from taxel_server.core.jobs import Job
from taxel_server.core.pacing import RefusalPace
from taxel_server.engine import LoadedModel
from taxel_server.options import ServerOptions
from taxel_server.transports.access import security_settings
from taxel_server.transports.metadata_thread import MetadataThread
from taxel_server.transports.outgoing import Outgoing, reply
from taxel_server.transports.zenoh_clients import Asker, ZenohClients
from taxel_server.transports.zenoh_session import open_session

_LOG: Final = logging.getLogger(__name__)

_NOTHING: Final = zenoh.ZBytes(b"")

CLIENT: Final = "zenoh"
"""What clients over zenoh are called in logs."""

CHANNEL: Final = 2
"""The most queries in the channel; if it is full, zenoh reads no more, and clients wait to send.

What is in it is neither counted nor refused yet. While the queue is full, all of it is refused between two
pauses. A longer one makes a client that asks for little wait for the refusals of others.
"""

_MORE_BYTES: Final = 32 * 2**20
"""A message that is larger than a request by less gets its error; zenoh drops larger ones unread."""

_FAREWELL_S: Final = 0.2
"""How long closing waits for clients that have stopped reading."""


class QueryJob(Job):
    """An inference query."""

    caller = CLIENT

    def __init__(
        self,
        query: zenoh.Query,
        payload: zenoh.ZBytes,
        model: LoadedModel,
        rows: int,
        reader: RequestReader,
        asker: Asker,
        outgoing: Outgoing,
    ) -> None:
        super().__init__(model, rows, len(payload), asker.client, name=asker.name)
        self._query = query
        self._payload = payload
        self._reader = reader
        self._outgoing = outgoing

    @override
    def decode(self) -> InferRequest:
        request = self._reader.read(self._payload.to_bytes())
        if request.id is not None:
            self.request_id = request.id
        self.traceparent = request.traceparent
        return request

    @override
    def answer(self, result: InferResponse | RequestError) -> None:
        answer = result if isinstance(result, RequestError) else pack_infer_response(result)
        self._outgoing.give(self.client, self._query, answer)


class ZenohTransport:
    """Listens from `listen`, and answers from `start` until `close`.

    Args:
        core: what answers.
        options: where to listen, and the prefix of all keys.
    """

    def __init__(self, core: Core, options: ServerOptions) -> None:
        self._core = core
        self._options = options
        self._reader = RequestReader(core.max_request_rows)
        self._pace = RefusalPace(core.run_delay)
        self._below_prefix = len(options.prefix) + 1
        self._own_keys = ""
        self._outgoing = Outgoing()
        self._clients = ZenohClients(core.gone)
        self._metadata_thread = MetadataThread(
            lambda key: core.answer(self._path(key)),
            lambda key, payload, answer: core.take_order(self._path(key), payload, answer),
            lambda error: core.refusals.add(error, client=CLIENT),
        )

    def listen(self) -> None:
        """Open the session.

        Raises:
            SettingsError: an endpoint is malformed.
            TaxelError: an endpoint is occupied.
        """
        session = open_session(
            self._options.listen,
            shared_memory=self._options.shared_memory,
            max_message_bytes=self._core.max_request_bytes + _MORE_BYTES,
            security=security_settings(self._options),
        )
        self._session = session
        self._core.statistics.connections["zenoh"] = lambda: len(session.info.transports())

    def start(self) -> None:
        """Take queries."""
        self._metadata_thread.start()
        self._clients.watch(self._session)
        # Before the keys: a client takes answers only from a server that it knows of.
        own = f"{self._options.prefix}/{REPLICAS}/{self._session.info.zid()}"
        self._own_keys = f"{own}/"
        # One queryable for all common keys: two that overlap would both answer a query.
        # With `complete`, one replica answers each query; by default all would.
        # Its own keys first: a client takes silence there for a denial once it knows of the common ones.
        keys = f"{own}/**", f"{self._options.prefix}/**"
        self._queryables = [self.declare(self._session, key) for key in keys]
        # Last: who sees the token may ask.
        self._token = self._session.liveliness().declare_token(own)
        self._receivers = [
            Thread(target=self._receive, args=(each.handler,), name="taxel-receiver", daemon=True)
            for each in self._queryables
        ]
        for receiver in self._receivers:
            receiver.start()

    def declare(self, session: zenoh.Session, key: str) -> zenoh.Queryable[Handler[zenoh.Query]]:
        """Begin to take the queries for a key, each of which one replica answers."""
        return session.declare_queryable(key, FifoChannel(CHANNEL), complete=True)

    def withdraw(self) -> None:
        """Tell clients of several servers to ask the others from now on."""
        self._token.undeclare()  # type: ignore[no-untyped-call]

    def close(self) -> bool:
        """Answer what has arrived, and close the session; call it after the core was drained.

        Returns:
            False if a client that has stopped reading kept the session open.
        """
        for queryable in reversed(self._queryables):
            queryable.undeclare()  # type: ignore[no-untyped-call]
        self._clients.close()
        for receiver in self._receivers:
            receiver.join()
        self._metadata_thread.close()
        self._outgoing.close(self._options.drain_seconds)
        return self.hang_up()

    def hang_up(self) -> bool:
        """Close the session; enough where `start` was not called. Returns as `close` does."""
        return close_session(self._session, patience_s=_FAREWELL_S)

    def _receive(self, channel: Handler[zenoh.Query]) -> None:
        """Pass queries on until the channel is closed and empty."""
        while (query := _taken(channel.recv)) is not None:
            following = _taken(channel.try_recv)
            self._hand_on(query, self._core.run if following is None else self._core.submit)
            while following is not None:
                self._hand_on(following, self._core.submit)
                following = _taken(channel.try_recv)

    def _hand_on(self, query: zenoh.Query, infer: Callable[[Job], None]) -> None:
        """Give a query to the core or to the metadata thread."""
        try:
            self._route(query, infer)
        except Exception:
            # The receiver must survive a query that cannot be passed on.
            _LOG.exception("a query could not be handed on")
            self._metadata_thread.take(query, Internal("the query failed: the server's log says more"))

    def _path(self, key: str) -> str:
        """The path that a key names, whether a common one or this server's own."""
        if key.startswith(self._own_keys):
            return key[len(self._own_keys) :]
        return key[self._below_prefix :]

    def _route(self, query: zenoh.Query, infer: Callable[[Job], None]) -> None:
        path = self._path(str(query.key_expr))
        model = self._core.model_at(path)
        if model is None:
            # Here: it must not overtake the request that it gives up.
            if path == CANCEL_PATH:
                name = self._clients.asker_of(query).name
                reply(query, packb({"cancelled": name is not None and self._core.cancel(name)}))
            else:
                self._metadata_thread.take(query)
            return
        payload = query.payload or _NOTHING
        asker = self._clients.asker_of(query)
        try:
            rows = self._reader.rows_in(len(payload), len(model.manifest.window.features))
            infer(QueryJob(query, payload, model, rows, self._reader, asker, self._outgoing))
        except RequestError as error:
            # Here and now: in a queue of refusals, a flood would grow in another place.
            self._core.refusals.add(error, client=CLIENT, model=model.label)
            self._outgoing.give(asker.client, query, error)
            if isinstance(error, ResourceExhausted) and (pause_s := self._pace.refused(time.monotonic())):
                # What is not read waits in the connection of its client, which slows a flood down and
                # nobody else: zenoh reads each connection by itself.
                self._core.wait_until_idle(pause_s)


def _taken(take: Callable[[], zenoh.Query | None]) -> zenoh.Query | None:
    """The next query of a channel; None if there is none, or if the channel is closed."""
    try:
        return take()
    except zenoh.ZError:
        return None

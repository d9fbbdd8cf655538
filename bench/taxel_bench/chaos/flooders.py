"""Who floods: Taxel's client, or one that is written with zenoh alone."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

import zenoh
from zenoh.handlers import Callback

from taxel.errors import DeadlineExceeded, RequestError, Unavailable
from taxel.protocol import unpack_error
from taxel.remote import RemoteSource
from taxel.remote.known_servers import TIMEOUT
from taxel.remote.query_transport import Done
from taxel_bench.plain_client import client_config

FLOODERS: Final = "taxel", "zenoh"
"""Taxel's client sends no more than the server lets it queue; the other one sends everything."""

Send = Callable[[bytes, Done], object]
"""Sends a request without waiting for its answer."""


@contextmanager
def sender(flooder: str, source: RemoteSource, key: str) -> Iterator[Send]:
    """What sends to a key of a source's server."""
    if flooder == "taxel":
        yield lambda payload, done: source.connection.send(key, payload, source.timeout, done)
        return
    with zenoh.open(client_config(source.endpoint)) as session:
        as_they_come = zenoh.ConsolidationMode.NONE
        querier = session.declare_querier(key, timeout=source.timeout, consolidation=as_they_come)
        yield lambda payload, done: _query(querier, payload, done)


def _query(querier: zenoh.Querier, payload: bytes, done: Done) -> None:
    outcome: bytes | RequestError = Unavailable("the query ended without a reply")

    def read(reply: zenoh.Reply) -> None:
        nonlocal outcome
        if reply.ok is not None:
            outcome = reply.ok.payload.to_bytes()
        elif reply.err is not None:
            text = reply.err.payload.to_bytes()
            outcome = DeadlineExceeded("zenoh waited no longer") if text == TIMEOUT else unpack_error(text)

    handler: Callback[zenoh.Reply] = Callback(read, lambda: done(outcome), indirect=False)
    querier.get(handler, payload=payload)

"""What `taxel.connect` and `taxel.connect_async` are given: checked before anything is opened."""

import re
import time
from typing import Any, Final, Literal, NamedTuple, Self

from taxel.arguments import checked_flag, checked_timeout
from taxel.endpoints import checked_endpoint
from taxel.errors import InvalidArgument, Unavailable
from taxel.remote.credentials import Credentials
from taxel.remote.query_transport import QueryTransport
from taxel.remote.replicas import Replicas
from taxel.remote.zenoh_connection import Connection

Transport = Literal["zenoh", "lane"]
"""A transport that can be asked for by its name."""

_EACH_S: Final = 0.5
"""How long one of several endpoints is waited for at a time."""

_PREFIX: Final = re.compile(r"[A-Za-z0-9._-]+(/[A-Za-z0-9._-]+)*")


class ConnectOptions(NamedTuple):
    """Checked arguments; see `taxel.connect`.

    Attributes:
        transport: opened by the caller; if none, zenoh at the endpoint.
        lane: whether to look for a lane; `only` if windows may go no other way.
    """

    endpoints: tuple[str, ...]
    timeout: float
    prefix: str
    shared_memory: bool
    credentials: Credentials
    transport: QueryTransport | None
    lane: Literal["no", "yes", "only"]

    @classmethod
    def checked(
        cls,
        endpoint: Any,
        timeout: Any,
        prefix: Any,
        shared_memory: Any,
        credentials: Any,
        transport: Any,
    ) -> Self:
        """Check the arguments of a connection.

        Raises:
            InvalidArgument: one is wrong; the text names it.
            SettingsError: the credentials of the environment or of `taxel.toml` are wrong.
        """
        if not isinstance(prefix, str) or not _PREFIX.fullmatch(prefix):
            raise InvalidArgument(
                f"prefix is {prefix!r}: expected parts of letters, digits, '.', '_' and '-'"
            )
        common = checked_timeout(timeout), prefix, checked_flag("shared_memory", shared_memory)
        if not isinstance(credentials, (Credentials, type(None))):
            raise InvalidArgument(
                f"credentials are {type(credentials).__name__}: expected taxel.Credentials"
            )
        if isinstance(transport, QueryTransport):
            if endpoint is not None:
                raise InvalidArgument(f"endpoint is {endpoint!r}: expected none, as a transport is given")
            return cls((), *common, Credentials(), transport, "no")
        if transport is not None and transport not in ("lane", "zenoh"):
            raise InvalidArgument(
                f"transport is {transport!r}: expected 'lane', 'zenoh' or None, or a QueryTransport"
            )
        lane: dict[Any, Literal["no", "yes", "only"]] = {None: "yes", "lane": "only", "zenoh": "no"}
        given = endpoint if isinstance(endpoint, (list, tuple)) and endpoint else [endpoint]
        endpoints = tuple(dict.fromkeys(checked_endpoint(each) for each in given))
        if transport == "lane" and len(endpoints) > 1:
            raise InvalidArgument(f"endpoint is {endpoint!r}: expected one, as a lane leads to one server")
        trusted = credentials or Credentials.from_surroundings()
        return cls(endpoints, *common, trusted, None, lane[transport])

    @property
    def endpoint(self) -> str:
        """Where the servers are, for error texts."""
        return self.transport.endpoint if self.transport else ", ".join(self.endpoints)


def open_transport(options: ConnectOptions) -> QueryTransport:
    """What carries the queries; errors as in `taxel.connect`."""
    if options.transport is not None:
        return options.transport
    if len(options.endpoints) > 1:
        return _open_several(options)
    connection = _connection(options, options.endpoint, options.timeout)
    if connection.is_to_router and options.lane != "only":
        return Replicas([connection], options.prefix)
    return connection


def lane_of(options: ConnectOptions, transport: QueryTransport) -> Literal["no", "yes", "only"]:
    """Whether to look for a lane. It leads to one server, and so past all others."""
    return "no" if isinstance(transport, Replicas) else options.lane


def _open_several(options: ConnectOptions) -> Replicas:
    """Connections to those endpoints where somebody listens, at least one; the others follow later."""
    ends = time.monotonic() + options.timeout
    missing = list(options.endpoints)
    opened: list[Connection] = []
    while not opened:
        for endpoint in tuple(missing):
            try:
                opened.append(_connection(options, endpoint, min(options.timeout, _EACH_S)))
                missing.remove(endpoint)
            except Unavailable:
                if time.monotonic() >= ends and not opened:
                    raise
    return Replicas(opened, options.prefix, missing, lambda each: _connection(options, each, _EACH_S))


def _connection(options: ConnectOptions, endpoint: str, timeout: float) -> Connection:
    return Connection(
        endpoint,
        options.prefix,
        timeout,
        patience=options.timeout,
        shared_memory=options.shared_memory,
        credentials=options.credentials,
    )
